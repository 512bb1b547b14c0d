"""``python -m worker.records.migrations 0002_word "What it does."``: writes the migration to the tables of the code."""

from __future__ import annotations

import sys

import sqlalchemy as sa

from worker.records import schema


def main() -> int:
    """Compares with a fresh database of the newest migration."""
    if len(sys.argv) != 3:
        print(__doc__, file=sys.stderr)
        return 2
    schema.write_migration(sa.create_engine("sqlite://"), sys.argv[1], sys.argv[2])
    return 0


if __name__ == "__main__":
    sys.exit(main())
