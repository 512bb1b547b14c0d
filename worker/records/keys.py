"""API keys: who may ask for what. Only the SHA-256 of a secret is stored, with scopes, expiry and quotas.

A secret is ``tomosim_<id>_<64 hexadecimal digits>``: the middle names the row, the end is 256 random bits.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, fields

import sqlalchemy as sa

from tomosim_contract.names import Scope
from worker.records.database import Repository, columns_of, metadata, reading, rows_of
from worker.settings import Settings, SettingsError, is_loopback

USED_SECONDS = 60.0
"""The time of the last use is kept to within this many seconds, so that reading does not write each time."""

_SECRET = re.compile("tomosim_([0-9a-f]{12})_[0-9a-f]{64}")

table = sa.Table(
    "api_keys",
    metadata,
    sa.Column("id", sa.String(12), primary_key=True),
    sa.Column("name", sa.String(100), nullable=False),
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("scopes", sa.JSON, nullable=False),
    sa.Column("created", sa.Double, nullable=False),
    sa.Column("expires", sa.Double),
    sa.Column("revoked", sa.Double),
    sa.Column("last_used", sa.Double),
    # Quotas of this key; NULL: those of the settings.
    sa.Column("active_cases", sa.Integer),
    sa.Column("cases_per_day", sa.Integer),
)


@dataclass(frozen=True)
class Key:
    """A row without its digest. Times: seconds since 1970."""

    id: str
    name: str
    scopes: list[Scope]
    created: float
    expires: float | None
    revoked: float | None
    last_used: float | None
    active_cases: int | None
    cases_per_day: int | None

    def end(self, now: float) -> str | None:
        """``revoked`` or ``expired`` where it is not good any more."""
        if self.revoked is not None:
            return "revoked"
        return "expired" if self.expires is not None and self.expires <= now else None


_COLUMNS = columns_of(table, Key)


class Keys(Repository):
    """Repository of API keys."""

    def create(
        self,
        name: str,
        scopes: Sequence[Scope],
        expires: float | None = None,
        active_cases: int | None = None,
        cases_per_day: int | None = None,
    ) -> tuple[Key, str]:
        """A new key and its secret, which is told this once.

        expires: seconds since 1970. active_cases, cases_per_day: quotas other than those of the settings; 0: none.
        """
        identifier = secrets.token_hex(6)
        secret = f"tomosim_{identifier}_{secrets.token_hex(32)}"
        key = Key(identifier, name, list(scopes), self.clock(), expires, None, None, active_cases, cases_per_day)
        values = {f.name: getattr(key, f.name) for f in fields(Key)}
        with self.engine.begin() as connection:
            connection.execute(table.insert().values(sha256=digest(secret), **values))
        return key, secret

    def all(self) -> list[Key]:
        """Every key that was ever made, oldest first."""
        with reading(self.engine) as connection:
            return rows_of(connection.execute(sa.select(*_COLUMNS).order_by(table.c.created, table.c.id)), Key)

    def exist(self) -> bool:
        """Whether a key was ever made. One that was revoked counts: what was closed does not open by itself."""
        with reading(self.engine) as connection:
            return connection.scalar(sa.select(table.c.id).limit(1)) is not None

    def find(self, secret: str) -> Key | None:
        """The key of a secret, revoked and expired ones included; None where there is none."""
        match = _SECRET.fullmatch(secret)
        if match is None:
            return None
        query = sa.select(table.c.sha256, *_COLUMNS).where(table.c.id == match[1])
        with reading(self.engine) as connection:
            row = connection.execute(query).mappings().one_or_none()
        if row is None or not hmac.compare_digest(row["sha256"], digest(secret)):
            return None
        return Key(**{name: value for name, value in row.items() if name != "sha256"})

    def mark_used(self, key: Key) -> None:
        """Keeps the time of use."""
        now = self.clock()
        if key.last_used is None or now - key.last_used > USED_SECONDS:
            with self.engine.begin() as connection:
                connection.execute(table.update().where(table.c.id == key.id).values(last_used=now))

    def revoke(self, identifier: str) -> bool:
        """Ends a key at once; False where there is none, or it was revoked before."""
        good = (table.c.id == identifier, table.c.revoked.is_(None))
        with self.engine.begin() as connection:
            return bool(connection.execute(table.update().where(*good).values(revoked=self.clock())).rowcount)


def digest(secret: str) -> str:
    """What is stored of a secret."""
    return hashlib.sha256(secret.encode()).hexdigest()


def check_address(settings: Settings, keys: Keys) -> None:
    """Whether the API may bind to the host of the settings.

    raises: SettingsError where others could reach it and nobody needs a key.
    """
    if settings.trusted_network or is_loopback(settings.host) or settings.admin_secret or keys.exist():
        return
    raise SettingsError(
        f"TOMOSIM_HOST = {settings.host!r}: without API keys only a loopback address is allowed (127.0.0.1, ::1, "
        "localhost); make a key with 'tomosim keys create', set TOMOSIM_ADMIN_KEY, or set "
        "TOMOSIM_TRUSTED_NETWORK=true where everybody who can reach the address may do everything"
    )
