"""``python -m tomosim``, and the command ``tomosim``."""

import sys

from tomosim import own


def main() -> int:
    """Runs one command; returns its exit code."""
    own.leave_out_current_folder()
    own.take_own()
    from tomosim.cli import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
