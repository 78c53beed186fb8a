"""``python -m freetalk.cli``."""

import sys

from freetalk.cli.app import main

sys.exit(main())
