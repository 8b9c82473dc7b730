"""How much the lane does: small by default, ``FUZZ_UPLOADS=20000 make test-fuzz`` for all of it."""

from __future__ import annotations

import os

UPLOADS = int(os.environ.get("FUZZ_UPLOADS", "2000"))
"""Number of mutated uploads"""
STREAMS = int(os.environ.get("FUZZ_STREAMS", "500"))
"""Number of mutated streams"""
FIRST = int(os.environ.get("FUZZ_FIRST", "0"))
"""Index of the first mutant: a failing one is repeated with its index and a size of 1"""
EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "40"))
"""Examples of schemathesis per operation"""
