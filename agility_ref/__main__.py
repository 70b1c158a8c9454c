"""``python -m agility_ref`` is ``agility-ref``."""

import sys

from agility_ref.cli.main import main

sys.exit(main())
