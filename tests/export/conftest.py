"""One torch thread: the networks here are small, and the machine runs other tests beside them."""

from __future__ import annotations

import torch

torch.set_num_threads(1)
