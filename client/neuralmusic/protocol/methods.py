"""Names of the localization methods and of the hemispheres, the same in every interface."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["neural", "norm_music", "music", "srp_phat", "gcc_phat"]
METHODS: tuple[Method, ...] = get_args(Method)
Hemisphere = Literal["both", "upper", "lower"]
"""Side of the horizontal plane on which sources are"""
HEMISPHERES: tuple[Hemisphere, ...] = get_args(Hemisphere)
