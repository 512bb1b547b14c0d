"""``python -m bench.figures``."""

import sys

from bench.figures.run import main

if __name__ == "__main__":
    sys.exit(main())
