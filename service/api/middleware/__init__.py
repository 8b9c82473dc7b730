"""ASGI middleware: what every request passes before its endpoint."""
