"""Tables and rows of deliveries: what goes to a destination, and how far each instance has come."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import sqlalchemy as sa

from tomosim_contract.names import FINAL_STATES, InstanceState, Queue, failure
from worker.records.database import metadata
from worker.records.rows import Json, Leased

deliveries = sa.Table(
    "deliveries",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("state", sa.String(16), nullable=False),
    # No foreign keys: a delivery stays on record when its case or its destination is forgotten.
    sa.Column("destination_id", sa.String(32), nullable=False),
    sa.Column("destination_name", sa.String(64), nullable=False),
    sa.Column("simulation_id", sa.String(32)),
    sa.Column("study_id", sa.String(32)),
    sa.Column("automatic", sa.Boolean, nullable=False),
    sa.Column("revision", sa.Integer, nullable=False, default=1),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("started", sa.Double),
    sa.Column("finished", sa.Double),
    sa.Column("attempt", sa.Integer, nullable=False, default=0),
    # How often it was tried since an instance was last stored.
    sa.Column("failures", sa.Integer, nullable=False, default=0),
    sa.Column("not_before", sa.Double),
    sa.Column("sent", sa.Double),
    sa.Column("owner", sa.String(200)),
    sa.Column("lease_until", sa.Double),
    sa.Column("message", sa.Text, nullable=False, default=""),
    sa.Column("error", sa.JSON(none_as_null=True)),
    sa.Column("instances", sa.Integer, nullable=False),
    sa.Column("instances_stored", sa.Integer, nullable=False, default=0),
    sa.Column("instances_failed", sa.Integer, nullable=False, default=0),
    sa.Column("bytes", sa.BigInteger, nullable=False),
    sa.Column("bytes_stored", sa.BigInteger, nullable=False, default=0),
    sa.Index("deliveries_by_age", "created", "id"),
    sa.Index("deliveries_by_destination", "destination_id", "state"),
    sa.Index("deliveries_by_simulation", "simulation_id"),
)

instances = sa.Table(
    "delivery_instances",
    metadata,
    sa.Column("delivery_id", sa.String(32), sa.ForeignKey("deliveries.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("destination_id", sa.String(32), nullable=False),
    sa.Column("simulation_id", sa.String(32), nullable=False),
    sa.Column("name", sa.Text, nullable=False),
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("size", sa.BigInteger, nullable=False),
    # Of the file's meta information; NULL until it was read.
    sa.Column("sop_instance", sa.String(64)),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("attempts", sa.Integer, nullable=False, default=0),
    sa.Column("status", sa.Integer),
    sa.Column("code", sa.String(64)),
    sa.Column("message", sa.Text, nullable=False, default=""),
    sa.Column("finished", sa.Double),
    sa.Index("delivery_instances_by_uid", "sop_instance", "destination_id"),
)

delivery_events = sa.Table(
    "delivery_events",
    metadata,
    sa.Column("delivery_id", sa.String(32), sa.ForeignKey("deliveries.id", ondelete="CASCADE"), primary_key=True),
    sa.Column("sequence", sa.Integer, primary_key=True),
    sa.Column("at", sa.Double, nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("data", sa.JSON, nullable=False),
)


@dataclass(frozen=True)
class Delivery(Leased):
    """A row. not_before: seconds since 1970 before which it is not tried again."""

    destination_id: str
    destination_name: str
    simulation_id: str | None
    study_id: str | None
    automatic: bool
    failures: int
    not_before: float | None
    message: str
    instances: int
    instances_stored: int
    instances_failed: int
    bytes: int
    bytes_stored: int

    @property
    def queue(self) -> Queue:
        return "delivery"


@dataclass(frozen=True)
class Instance:
    """A file on its way. size: bytes; status: of the C-STORE response; finished: seconds since 1970."""

    number: int
    simulation_id: str
    name: str
    sha256: str
    size: int
    sop_instance: str | None
    state: InstanceState
    attempts: int
    status: int | None
    code: str | None
    message: str
    finished: float | None


@dataclass(frozen=True)
class Item:
    """A file to be sent, as the manifest of its case names it."""

    simulation_id: str
    name: str
    sha256: str
    size: int


@dataclass(frozen=True)
class Request:
    """What a delivery is asked to be. simulation_id, study_id: what was asked for; None where it is not that."""

    destination: str
    items: Sequence[Item]
    simulation_id: str | None = None
    study_id: str | None = None
    automatic: bool = False


Verdict = Literal["stored", "again", "refused"]


@dataclass(frozen=True)
class Outcome:
    """verdict: what becomes of the instance. code: stable. message: for people, with what to do.

    status: of the C-STORE response; None where none came.
    """

    verdict: Verdict
    code: str
    message: str = ""
    status: int | None = None

    def error(self) -> Json:
        return failure(self.code, self.message)


def items_of(simulation_id: str, manifest: Json, patterns: Sequence[str] = ()) -> list[Item]:
    """The DICOM files of a case whose names match one of the patterns (``projections/*``); all where there is none."""
    files = manifest.get("files", {})
    chosen = sorted(name for name in files if name.endswith(".dcm") and matches(name, patterns))
    return [Item(simulation_id, name, files[name]["sha256"], files[name]["size"]) for name in chosen]


def matches(name: str, patterns: Sequence[str]) -> bool:
    return not patterns or any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)


def unfinished(connection: sa.Connection, destination_id: str) -> int:
    """How many deliveries to a destination have not ended."""
    c = deliveries.c
    query = sa.select(sa.func.count()).where(c.destination_id == destination_id, c.state.not_in(FINAL_STATES))
    return connection.scalar(query) or 0
