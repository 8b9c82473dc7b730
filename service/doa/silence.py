"""The level below which audio is silence."""

from __future__ import annotations

SILENCE = 1e-9
"""Mean square at -90 dBFS, below the rounding noise of 14 bits: nothing was recorded"""
