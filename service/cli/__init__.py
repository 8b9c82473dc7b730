"""Commands that the service adds to ``neuralmusic``, one module each.

``neuralmusic.cli`` says what such a module holds. To add one, name it in ``pyproject.toml`` under
``neuralmusic.commands`` and in ``neuralmusic.cli.commands.OF_THE_SERVICE``.
"""
