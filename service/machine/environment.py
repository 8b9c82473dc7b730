"""Environment variables for the libraries that a process of the service loads."""

from __future__ import annotations

import os

TELEMETRY = "ORT_DISABLE_TELEMETRY"
VARIABLES = {
    # Windows are small: threads of BLAS cost more than they gain, and several workers would each
    # bring a pool of the host's size.
    "OPENBLAS_NUM_THREADS": "1",
    # onnxruntime 1.29 and later report to Microsoft, with an identifier that they keep in the home
    # folder. A robot's service calls nobody.
    TELEMETRY: "1",
}
"""Variables that numpy and onnxruntime read when they are first imported"""


def prepare_process() -> None:
    """Set the variables that the user has not set, before numpy or onnxruntime is imported."""
    for name, value in VARIABLES.items():
        os.environ.setdefault(name, value)


def disable_telemetry() -> None:
    """Turn off onnxruntime's reports alone, in a process that is not the service's own."""
    os.environ.setdefault(TELEMETRY, VARIABLES[TELEMETRY])
