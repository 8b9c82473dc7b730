"""NeuralMUSIC Service: sound source localization for robots."""

import os

# Windows are small: threads of BLAS cost more than they gain, and several workers would each bring
# a pool of the host's size. numpy reads this when it is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
