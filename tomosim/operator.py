"""``tomosim db``, ``store``, ``gc``: what an operator runs by hand, with the settings of the environment."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import sqlalchemy as sa


def add_commands(commands: Any) -> None:
    """Adds the operator's commands to the parser of the command line."""
    of_database = commands.add_parser("db", help="the tables of the database: revision, upgrade").add_subparsers(
        title="commands", required=True, metavar="COMMAND"
    )
    p = of_database.add_parser("upgrade", help="bring the tables up to date (TOMOSIM_DATABASE_URL)")
    p.set_defaults(run=_on_database(_upgrade))
    p = of_database.add_parser("downgrade", help="take migrations back; what they added is lost")
    p.add_argument("revision", metavar="REVISION", help="to which; 'base' removes every table")
    p.set_defaults(run=_on_database(_downgrade))
    p = of_database.add_parser("current", help="revision of the database, and the one this program needs")
    p.set_defaults(run=_on_database(_current))

    of_store = commands.add_parser("store", help="the stage store: try it out").add_subparsers(
        title="commands", required=True, metavar="COMMAND"
    )
    p = of_store.add_parser("check", help="whether the store can be used (TOMOSIM_STORE_URL, or the data folder)")
    p.add_argument("--make", action="store_true", help="make the bucket where there is none")
    p.set_defaults(run=_check_store)

    p = commands.add_parser("gc", help="remove from the store what no case needs any more")
    p.add_argument("--dry-run", action="store_true", help="only say what would be removed")
    p.set_defaults(run=_on_database(_collect))


def _on_database(action: Callable[[sa.Engine, argparse.Namespace], None]) -> Callable[[argparse.Namespace], None]:
    def run(args: argparse.Namespace) -> None:
        from sqlalchemy.exc import SQLAlchemyError

        from simcore.core.errors import StoreError
        from worker.records.database import connect
        from worker.settings import Settings

        engine = connect(Settings.load().resolved_database_url)
        try:
            action(engine, args)
        except SQLAlchemyError as error:
            where = engine.url.render_as_string(hide_password=True)
            raise StoreError(f"the database {where} cannot be used: {error}", code="database-unavailable") from error
        finally:
            engine.dispose()

    return run


def _upgrade(engine: sa.Engine, args: argparse.Namespace) -> None:
    from worker.records import schema

    before = schema.current(engine)
    schema.upgrade(engine)
    after = schema.current(engine)
    print(f"already at revision {after}" if before == after else f"upgraded from {before or 'nothing'} to {after}")


def _downgrade(engine: sa.Engine, args: argparse.Namespace) -> None:
    from worker.records import schema

    schema.downgrade(engine, args.revision)
    print(f"now at revision {schema.current(engine) or 'base'}")


def _current(engine: sa.Engine, args: argparse.Namespace) -> None:
    from worker.records import schema

    print(f"database: {schema.current(engine) or 'no tables'}; this program needs: {schema.newest()}")


def _collect(engine: sa.Engine, args: argparse.Namespace) -> None:
    import time

    from worker.records import schema
    from worker.settings import Settings
    from worker.storage import open_store
    from worker.upkeep.garbage import collect

    settings = Settings.load()
    schema.require_current(engine)
    done = collect(engine, open_store(settings), settings.gc_grace_seconds, time.time(), args.dry_run)
    print(
        f"{'would remove' if args.dry_run else 'removed'} {done.records} stages and {done.objects} files "
        f"({done.size / 1e9:.2f} GB); {done.kept_objects} files ({done.kept_size / 1e9:.2f} GB) stay"
    )


def _check_store(args: argparse.Namespace) -> None:
    from worker.settings import Settings
    from worker.upkeep.store_check import check

    print(check(Settings.load(), args.make))
