"""References for readers, written from the program: ``docs/cli.md`` and ``docs/python.md``."""
