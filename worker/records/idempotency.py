"""Keys under which clients repeat a request without doing it twice: their table and its repository."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from worker.records.database import metadata

Json = dict[str, Any]

ABANDONED_SECONDS = 60.0
"""A request that has not ended after this time is taken for dead: another one with its key may go on in its place."""

keys = sa.Table(
    "idempotency_keys",
    metadata,
    sa.Column("principal", sa.String(64), primary_key=True),
    sa.Column("key", sa.String(255), primary_key=True),
    # Digest of method, path and body.
    sa.Column("fingerprint", sa.String(64), nullable=False),
    # Of what the request makes: whoever goes on in the place of a dead request makes the same again, or finds it made.
    sa.Column("identifier", sa.String(32), nullable=False),
    # {status, headers, body}; NULL: not answered yet.
    sa.Column("answer", sa.JSON(none_as_null=True)),
    sa.Column("claim", sa.String(32), nullable=False),
    sa.Column("claimed_until", sa.Double, nullable=False),
    sa.Column("expires", sa.Double, nullable=False),
    sa.Index("idempotency_keys_by_age", "expires"),
)


class KeyReusedError(Exception):
    """The key was used with another request."""


class KeyBusyError(Exception):
    """A request with this key is under way."""


@dataclass(frozen=True)
class Claim:
    """The right to answer a request.

    identifier: to be given to what the request makes. again: whether an earlier request may have made it already.
    answer: where there is one already, it is given again and nothing is done.
    """

    principal: str
    key: str
    token: str
    identifier: str
    again: bool
    answer: Json | None


class Idempotency:
    """Repository of keys.

    ttl_seconds: how long an answer is kept, from the first request on. clock: seconds since 1970.
    """

    def __init__(self, engine: sa.Engine, ttl_seconds: float, clock: Callable[[], float] = time.time) -> None:
        self.engine = engine
        self.ttl_seconds = ttl_seconds
        self.clock = clock

    def claim(self, principal: str, key: str, fingerprint: str) -> Claim:
        """Begins a request.

        raises: KeyReusedError where the key belongs to another request, KeyBusyError where the same is under way.
        """
        try:
            return self._claim(principal, key, fingerprint)
        except IntegrityError:
            # The same key at the same moment: the other one was first, and is found now.
            return self._claim(principal, key, fingerprint)

    def answer(self, claim: Claim, answer: Json) -> None:
        """Keeps the answer of a request."""
        self._end(claim, keys.update().values(answer=answer))

    def release(self, claim: Claim) -> None:
        """Forgets a request that did nothing: its key may be used again, with another body as well."""
        self._end(claim, keys.delete())

    def abandon(self, claim: Claim) -> None:
        """Gives up a request that may have done something: whoever repeats it goes on at once."""
        self._end(claim, keys.update().values(claimed_until=0.0))

    def forget(self) -> None:
        """Removes the keys that have expired."""
        with self.engine.begin() as connection:
            connection.execute(keys.delete().where(keys.c.expires < self.clock()))

    def _claim(self, principal: str, key: str, fingerprint: str) -> Claim:
        now = self.clock()
        mine = sa.and_(keys.c.principal == principal, keys.c.key == key)
        token = uuid.uuid4().hex
        with self.engine.begin() as connection:
            connection.execute(keys.delete().where(mine, keys.c.expires < now))
            row = connection.execute(sa.select(keys).where(mine).with_for_update()).one_or_none()
            if row is None:
                identifier = uuid.uuid4().hex
                connection.execute(
                    keys.insert().values(
                        principal=principal,
                        key=key,
                        fingerprint=fingerprint,
                        identifier=identifier,
                        claim=token,
                        claimed_until=now + ABANDONED_SECONDS,
                        expires=now + self.ttl_seconds,
                    )
                )
                return Claim(principal, key, token, identifier, again=False, answer=None)
            if row.fingerprint != fingerprint:
                raise KeyReusedError
            if row.answer is None:
                if row.claimed_until > now:
                    raise KeyBusyError
                values = {"claim": token, "claimed_until": now + ABANDONED_SECONDS}
                connection.execute(keys.update().where(mine).values(values))
            return Claim(principal, key, token, row.identifier, again=True, answer=row.answer)

    def _end(self, claim: Claim, statement: sa.Update | sa.Delete) -> None:
        mine = (keys.c.principal == claim.principal, keys.c.key == claim.key, keys.c.claim == claim.token)
        with self.engine.begin() as connection:
            connection.execute(statement.where(*mine))
