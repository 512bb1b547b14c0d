"""Destinations: archives and workstations that take DICOM. Their table and its repository."""

from __future__ import annotations

import uuid
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from tomosim_contract.destination import Destination
from worker.records.database import Repository, metadata, reading
from worker.records.delivery_tables import unfinished
from worker.records.rows import NotFoundError

Json = dict[str, Any]

destinations = sa.Table(
    "destinations",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("name", sa.String(64), nullable=False, unique=True),
    sa.Column("definition", sa.JSON, nullable=False),
    sa.Column("revision", sa.Integer, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
)


class NameTakenError(Exception):
    """Another destination has this name."""


class InUseError(Exception):
    """Deliveries to this destination have not ended; ``count`` of them."""

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self.count = count


@dataclass(frozen=True)
class DestinationRow:
    """A stored destination. created: seconds since 1970."""

    id: str
    revision: int
    created: float
    definition: Destination


class Destinations(Repository):
    """Repository of destinations."""

    def create(self, definition: Destination, identifier: str = "") -> DestinationRow:
        """identifier: a new one where empty. raises: NameTakenError"""
        row = DestinationRow(identifier or uuid.uuid4().hex, 1, self.clock(), definition)
        values = {"id": row.id, "revision": 1, "created": row.created, **_stored(definition)}
        try:
            with self.engine.begin() as connection:
                connection.execute(destinations.insert().values(values))
        except IntegrityError:
            with reading(self.engine) as connection:
                if connection.scalar(sa.select(sa.exists().where(destinations.c.id == row.id))):
                    raise  # not the name, but this very destination
            raise NameTakenError(definition.name) from None
        return row

    def get(self, identifier: str) -> DestinationRow:
        """By identifier. raises: NotFoundError"""
        row = self.find(identifier)
        if row.id != identifier:
            raise NotFoundError(identifier, "destination")
        return row

    def find(self, name: str) -> DestinationRow:
        """By identifier or name. raises: NotFoundError"""
        with reading(self.engine) as connection:
            return find(connection, name)

    def all(self) -> list[DestinationRow]:
        """By name."""
        with reading(self.engine) as connection:
            return [_row(r) for r in connection.execute(sa.select(destinations).order_by(destinations.c.name))]

    def replace(self, identifier: str, definition: Destination, revision: int) -> DestinationRow | None:
        """Changes a destination that still has this revision; None where another change came first.

        raises: NotFoundError, NameTakenError
        """
        c = destinations.c
        update = destinations.update().where(c.id == identifier, c.revision == revision)
        try:
            with self.engine.begin() as connection:
                changed = connection.execute(update.values(revision=revision + 1, **_stored(definition))).rowcount
                row = find(connection, identifier)
        except IntegrityError:
            raise NameTakenError(definition.name) from None
        return row if changed else None

    def delete(self, identifier: str, revision: int | None = None) -> bool:
        """Deliveries that have ended stay on record. raises: NotFoundError, InUseError

        revision: only where it still has this one; False where another change came first.
        """
        with self.engine.begin() as connection:
            lock(connection, identifier)
            if count := unfinished(connection, identifier):
                raise InUseError(count)
            unchanged = [] if revision is None else [destinations.c.revision == revision]
            if connection.execute(destinations.delete().where(destinations.c.id == identifier, *unchanged)).rowcount:
                return True
            find(connection, identifier)
            return False


def find(connection: sa.Connection, name: str) -> DestinationRow:
    """The destination with this identifier or name. raises: NotFoundError"""
    c = destinations.c
    row = connection.execute(sa.select(destinations).where(sa.or_(c.id == name, c.name == name))).first()
    if row is None:
        raise NotFoundError(name, "destination")
    return _row(row)


def lock(connection: sa.Connection, identifier: str) -> None:
    """Until the end of the transaction no other one passes here for the same destination."""
    # SQLite has locked the whole database already (records.database), and knows no FOR UPDATE.
    connection.execute(sa.select(destinations.c.id).where(destinations.c.id == identifier).with_for_update())


def _stored(definition: Destination) -> Json:
    return {"name": definition.name, "definition": definition.model_dump(mode="json")}


def _row(row: sa.Row[Any]) -> DestinationRow:
    return DestinationRow(row.id, row.revision, row.created, Destination.model_validate(row.definition))
