"""What a process of the service says to the libraries that it is about to load."""

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
"""numpy and onnxruntime read these when they are first imported"""


def prepare_process() -> None:
    """Set what the user has not set; to be called before numpy or onnxruntime is imported."""
    for name, value in VARIABLES.items():
        os.environ.setdefault(name, value)


def disable_telemetry() -> None:
    """The same for onnxruntime's reports alone, where the process is not the service's own."""
    os.environ.setdefault(TELEMETRY, VARIABLES[TELEMETRY])
