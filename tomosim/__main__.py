"""``python -m tomosim``"""

import sys

from tomosim.cli import main

sys.exit(main())
