"""Work that has to be done now and then by one of many processes."""

from __future__ import annotations

import time
from collections.abc import Callable

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from worker.records.database import metadata

chores = sa.Table(
    "chores",
    metadata,
    sa.Column("name", sa.String(32), primary_key=True),
    sa.Column("due", sa.Double, nullable=False),
)


class Chores:
    """Says whose turn it is."""

    def __init__(self, engine: sa.Engine, clock: Callable[[], float] = time.time) -> None:
        self.engine = engine
        self.clock = clock

    def claim(self, name: str, within_seconds: float) -> bool:
        """Whether the chore is due and this process is to do it.

        within_seconds: where it was not ``done`` by then, it is due again.
        """
        now = self.clock()
        due = chores.update().where(chores.c.name == name, chores.c.due <= now)
        try:
            with self.engine.begin() as connection:
                if connection.execute(due.values(due=now + within_seconds)).rowcount:
                    return True
                if connection.scalar(sa.select(chores.c.due).where(chores.c.name == name)) is not None:
                    return False
                connection.execute(chores.insert().values(name=name, due=now + within_seconds))
                return True
        except IntegrityError:
            return False  # another process has just begun

    def done(self, name: str, again_seconds: float) -> None:
        """The chore is due again after so long."""
        with self.engine.begin() as connection:
            connection.execute(chores.update().where(chores.c.name == name).values(due=self.clock() + again_seconds))
