"""``python -m bench.physics_transport``."""

import sys

from bench.physics_transport.run import main

if __name__ == "__main__":
    sys.exit(main())
