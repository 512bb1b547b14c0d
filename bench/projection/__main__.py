"""``python -m bench.projection``."""

import sys

from bench.projection.run import main

if __name__ == "__main__":
    sys.exit(main())
