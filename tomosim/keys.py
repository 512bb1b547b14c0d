"""``tomosim keys``: API keys of a service, in its database."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simcore.core.errors import SimulationError
from tomosim_contract.names import SCOPES

if TYPE_CHECKING:
    from worker.records.keys import Key, Keys

UNIT_SECONDS = {"h": 3600, "d": 86400, "w": 7 * 86400}


class NoSuchKeyError(SimulationError):
    """There is no such key, or it was revoked before."""

    kind = "user"
    code = "key-not-found"


def add_commands(commands: Any) -> None:
    """Adds the command ``keys`` with create, list and revoke."""
    of_keys = commands.add_parser("keys", help="API keys of a service").add_subparsers(
        title="commands", required=True, metavar="COMMAND"
    )
    p = of_keys.add_parser(
        "create",
        help="make a key; its secret is shown this once",
        description="As soon as a key was made, every request needs one. The secret is on standard output.",
    )
    p.add_argument("--name", required=True, type=_name, help="whose key it is, for people")
    p.add_argument("--scope", action="append", choices=SCOPES, help="what it may do; again for more (default: read)")
    p.add_argument("--expires", type=_expiry, metavar="90d", help="hours, days, weeks (12h, 90d, 8w) or a date")
    p.add_argument("--active-cases", type=_count, metavar="N", help="cases it may have queued or running; 0: any")
    p.add_argument("--cases-per-day", type=_count, metavar="N", help="cases it may post in 24 hours; 0: any")
    _service_argument(p)
    p.set_defaults(run=_create)
    p = of_keys.add_parser("list", help="list keys, without their secrets")
    _service_argument(p)
    p.set_defaults(run=_list)
    p = of_keys.add_parser("revoke", help="end a key at once")
    p.add_argument("id", help="its identifier, as 'tomosim keys list' shows it")
    _service_argument(p)
    p.set_defaults(run=_revoke)


def _create(args: argparse.Namespace) -> None:
    with _keys(args.data) as keys:
        scopes = args.scope or ["read"]
        _, secret = keys.create(args.name, sorted(set(scopes)), args.expires, args.active_cases, args.cases_per_day)
    print(secret)


def _list(args: argparse.Namespace) -> None:
    with _keys(args.data) as keys:
        rows: list[tuple[str, ...]] = [("ID", "NAME", "SCOPES", "CREATED", "EXPIRES", "LAST USED", "STATE")]
        rows += [_row(key, keys.clock()) for key in keys.all()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def _revoke(args: argparse.Namespace) -> None:
    with _keys(args.data) as keys:
        if not keys.revoke(args.id):
            raise NoSuchKeyError(f"there is no key {args.id!r} that could be revoked; see 'tomosim keys list'")


def _row(key: Key, now: float) -> tuple[str, ...]:
    times = (key.created, key.expires, key.last_used)
    return (key.id, key.name, ",".join(key.scopes), *map(_when, times), key.end(now) or "good")


def _when(seconds: float | None) -> str:
    return "-" if seconds is None else datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M")


def _name(text: str) -> str:
    if not 1 <= len(text) <= 100:
        raise argparse.ArgumentTypeError("1 to 100 characters")
    return text


def _expiry(text: str) -> float:
    """Seconds since 1970."""
    if match := re.fullmatch(r"([1-9]\d{0,4})([hdw])", text):
        return time.time() + int(match[1]) * UNIT_SECONDS[match[2]]
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is neither 12h, 90d, 8w nor a date such as 2030-01-31") from None
    seconds = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    if seconds <= time.time():
        raise argparse.ArgumentTypeError(f"{text!r} has passed")
    return seconds


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 0")
    return int(text)


def _service_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", type=Path, metavar="DIR", help="data folder of the service (default ./data)")


@contextmanager
def _keys(data: Path | None) -> Iterator[Keys]:
    from worker.records import schema
    from worker.records.database import connect
    from worker.records.keys import Keys
    from worker.settings import Settings

    settings = Settings.load(**({"data_folder": data} if data else {}))
    engine = connect(settings.resolved_database_url)
    try:
        schema.prepare(engine)
        yield Keys(engine)
    finally:
        engine.dispose()
