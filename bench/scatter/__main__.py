"""``python -m bench.scatter``."""

import sys

from bench.scatter.run import main

if __name__ == "__main__":
    sys.exit(main())
