"""``python -m bcid`` is the command line."""

import sys

from bcid.cli import main

sys.exit(main())
