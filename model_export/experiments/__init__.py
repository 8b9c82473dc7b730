"""The paper's tables and figures, each from one command: ``python -m model_export experiments``."""
