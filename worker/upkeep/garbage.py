"""Collection of garbage in the stage store: mark what is needed, sweep what was unused for a grace period.

Needed are the stages of every simulation whose files are kept, files that are to be delivered, and uploaded phantoms.
What was written or asked for within the grace period stays whatever it is: a case that runs finds what it has found
once. The store keeps removing and using apart (``Store.remove_record``); several collections at once do no harm.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import sqlalchemy as sa

from simcore.phantom.upload import registry
from simcore.store.store import Store
from tomosim_contract.names import FINAL_STATES
from worker.records.database import reading, simulations
from worker.records.delivery_tables import deliveries, instances
from worker.records.fleet import Chores
from worker.records.retention import Retention, unexpired
from worker.settings import Settings
from worker.upkeep.repeat import Repeated

log = logging.getLogger(__name__)

CHORE = "garbage"
MARGIN_SECONDS = 300.0
"""Clocks of machines may differ by so much."""

PAGE = 100


@dataclass
class Collection:
    """What was removed, and what stays. size: of the objects [byte]"""

    records: int = 0
    objects: int = 0
    size: int = 0
    kept_records: int = 0
    kept_objects: int = 0
    kept_size: int = 0


def collect(engine: sa.Engine, store: Store, grace_seconds: float, now: float, dry_run: bool = False) -> Collection:
    """One collection. dry_run: only says what would be removed.

    raises: StoreError, sqlalchemy.exc.SQLAlchemyError; what is needed is there all the same.
    """
    unused_since = now - grace_seconds
    keys, live = _needed(engine, now - MARGIN_SECONDS)
    live |= {upload.sha256 for upload in registry.uploads(store)}
    done = Collection()
    for stored in store.records():
        needed = stored.name in keys or stored.used >= unused_since
        if not needed and (dry_run or store.remove_record(stored.name, unused_since)):
            done.records += 1
            continue
        done.kept_records += 1
        record = store.record(stored.name)
        live |= {ref.sha256 for ref in record.outputs.values()} if record else set()
    for stored in store.objects():
        needed = stored.name in live or stored.used >= unused_since
        if not needed and (dry_run or store.remove_object(stored.name, unused_since)):
            done.objects += 1
            done.size += stored.size
        else:
            done.kept_objects += 1
            done.kept_size += stored.size
    return done


def _needed(engine: sa.Engine, now: float) -> tuple[set[str], set[str]]:
    """Keys of the records and digests of the objects of simulations whose files are kept, or under way to somebody."""
    keys: set[str] = set()
    digests: set[str] = set()
    for manifest in _manifests(engine, unexpired(now)):
        digests |= {ref["sha256"] for ref in manifest["files"].values()}
        for stage in manifest.get("stages", ()):
            keys.add(stage["key"])
            digests |= {ref["sha256"] for ref in stage.get("outputs", {}).values()}
    underway = deliveries.c.state.not_in(FINAL_STATES)
    sent = sa.select(instances.c.sha256).join(deliveries, deliveries.c.id == instances.c.delivery_id).where(underway)
    with reading(engine) as connection:
        digests |= set(connection.scalars(sent))
    return keys, digests


def _manifests(engine: sa.Engine, condition: sa.ColumnElement[bool]) -> Iterator[dict[str, Any]]:
    c = simulations.c
    query = sa.select(c.id, c.manifest).where(c.manifest.is_not(None), condition).order_by(c.id).limit(PAGE)
    after = ""
    while True:
        with reading(engine) as connection:
            rows = connection.execute(query.where(c.id > after)).all()
        yield from (row.manifest for row in rows)
        if len(rows) < PAGE:
            return
        after = rows[-1].id


class Collector:
    """Collects now and then in a thread of its own, one process at a time."""

    def __init__(
        self, settings: Settings, engine: sa.Engine, store: Store, clock: Callable[[], float] = time.time
    ) -> None:
        self.settings = settings
        self.engine = engine
        self.store = store
        self.clock = clock
        self.chores = Chores(engine, clock)
        self.retention = Retention(engine, clock)
        self._repeated = Repeated("garbage", self.sweep, min(60.0, settings.gc_interval_seconds))
        self.start = self._repeated.start

    def stop(self) -> None:
        """Ends the thread, at the latest when its pass is over or with the process."""
        self._repeated.stop(2.0)

    def sweep(self) -> Collection | None:
        """One pass where it is due and no other process does it. raises: Exception where database or store fail"""
        interval = self.settings.gc_interval_seconds
        if not self.chores.claim(CHORE, within_seconds=max(interval, 3600.0)):
            return None
        self.retention.complete_expiry()
        pruned = self.retention.prune_events(self.settings.event_seconds)
        collection = collect(self.engine, self.store, self.settings.gc_grace_seconds, self.clock())
        log.info("garbage collected", extra={**asdict(collection), "events": pruned})
        self.chores.done(CHORE, interval)
        return collection
