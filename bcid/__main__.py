"""``python -m bcid`` is the command line."""

import sys

from bcid.app.cli import main

sys.exit(main())
