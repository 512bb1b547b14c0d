"""What is known of the workers and of the queue as a whole, and whose turn it is to do what one of many does."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from worker.records.database import Repository, metadata, reading, simulations, workers

BEAT_SECONDS = 3.0
"""Interval at which a worker says that it is alive."""

SILENT_SECONDS = 15.0
"""A worker that was silent for longer counts as gone."""


DELIVERY_PREFIX = "delivery@"
"""How names of workers begin that deliver."""

chores = sa.Table(
    "chores",
    metadata,
    sa.Column("name", sa.String(32), primary_key=True),
    sa.Column("due", sa.Double, nullable=False),
)


class Fleet(Repository):
    """Repository of workers and counts."""

    def beat(self, worker: str, slots: int) -> None:
        """A worker says that it is alive."""
        values = {"slots": slots, "seen": self.clock()}
        with self.engine.begin() as connection:
            if not connection.execute(workers.update().where(workers.c.name == worker).values(values)).rowcount:
                connection.execute(workers.insert().values(name=worker, **values))

    def gone(self, worker: str) -> None:
        """A worker has stopped."""
        with self.engine.begin() as connection:
            connection.execute(workers.delete().where(workers.c.name == worker))

    def forget(self, silent_seconds: float) -> None:
        """Removes workers that have not been heard of for so long."""
        with self.engine.begin() as connection:
            connection.execute(workers.delete().where(workers.c.seen < self.clock() - silent_seconds))

    def alive(self, within_seconds: float = SILENT_SECONDS, host: str | None = None, *, delivery: bool = False) -> int:
        """How many workers (of a machine) said within these seconds that they are alive.

        delivery: those that deliver instead of those that simulate.
        """
        prefix = DELIVERY_PREFIX if delivery else ""
        query = sa.select(sa.func.count()).where(workers.c.seen > self.clock() - within_seconds)
        query = query.where(workers.c.name.startswith(DELIVERY_PREFIX, autoescape=True) == delivery)
        if host is not None:
            query = query.where(workers.c.name.startswith(f"{prefix}{host}:", autoescape=True))
        with reading(self.engine) as connection:
            return connection.scalar(query) or 0

    def ping(self) -> None:
        """raises: sqlalchemy.exc.SQLAlchemyError where the database does not answer or has no tables."""
        with reading(self.engine) as connection:
            connection.execute(sa.select(simulations.c.id).limit(1))

    def queues(self) -> dict[str, tuple[int, float]]:
        """How many simulations wait in a queue, and the seconds for which the oldest of them has been there."""
        c = simulations.c
        query = sa.select(c.queue, sa.func.count(), sa.func.min(c.created)).where(c.state == "queued").group_by(c.queue)
        now = self.clock()
        with reading(self.engine) as connection:
            rows = connection.execute(query).all()
        return {str(queue): (int(number), max(0.0, now - oldest)) for queue, number, oldest in rows}


class Chores(Repository):
    """Says whose turn it is."""

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
