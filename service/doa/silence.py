"""When audio holds nothing at all."""

from __future__ import annotations

SILENCE = 1e-9
"""Mean square of -90 dBFS, below the rounding noise of 14 bits: nothing was recorded"""
