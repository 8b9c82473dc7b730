"""Names of the localization methods, the same in every interface."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["neural", "norm_music", "music", "srp_phat"]
METHODS: tuple[Method, ...] = get_args(Method)
