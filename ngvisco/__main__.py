"""``python -m ngvisco``: the command ``ngvisco``."""

import sys

from ngvisco.cli.main import main

sys.exit(main())
