"""NeuralMUSIC Service: sound source localization for robots."""

import os

# Windows are small: threads of BLAS cost more than they gain, and several workers would each bring
# a pool of the host's size. numpy reads this when it is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# onnxruntime 1.29 and later report to Microsoft, with an identifier that they keep in the home
# folder; it reads this when it is first imported. A robot's service calls nobody.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

__version__ = "0.1.0"
