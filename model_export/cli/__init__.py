"""The command line, ``python -m model_export COMMAND``: one module per command."""
