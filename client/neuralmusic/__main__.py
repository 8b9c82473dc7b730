"""``python -m neuralmusic`` is the command line."""

import sys

from neuralmusic.cli import main

sys.exit(main())
