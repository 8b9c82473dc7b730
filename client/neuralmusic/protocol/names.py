"""What names and labels may be: the same for what comes in and for what was stored earlier."""

from __future__ import annotations

import re

NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
"""Names of robots, keys and noise profiles; they become parts of paths, headers and log lines"""
NAME_RULE = "1 to 64 letters, digits, dots, underscores and hyphens, the first a letter or a digit"
MAX_LABEL = 64
"""Most characters of a label"""


def is_name(text: str) -> bool:
    """Whether the text may be a name: nothing that leaves a folder or hides in it."""
    return re.fullmatch(NAME, text) is not None


def is_label(text: object) -> bool:
    """Whether it may be an array's label: one line of text that JSON can carry.

    Not printable are control characters and what is no character: surrogates, which JSON can spell
    and UTF-8 cannot, and numbers beyond Unicode.
    """
    return isinstance(text, str) and 0 < len(text) <= MAX_LABEL and text.isprintable()
