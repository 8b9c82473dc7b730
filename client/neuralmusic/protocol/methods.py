"""The methods of localization, by the names that every interface takes."""

from __future__ import annotations

from typing import Literal, get_args

Method = Literal["neural", "norm_music", "music", "srp_phat"]
METHODS: tuple[Method, ...] = get_args(Method)
