"""``python -m bench.schemathesis``."""

import sys

from bench.schemathesis.run import main

if __name__ == "__main__":
    sys.exit(main())
