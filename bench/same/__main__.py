"""``python -m bench.same``."""

import sys

from bench.same.run import main

if __name__ == "__main__":
    sys.exit(main())
