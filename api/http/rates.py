"""How fast an API key, or an address without one, may ask: a bucket that refills steadily (GCRA).

The buckets lie in the broker's Redis or valkey, so that several API processes share them. A broker that does not
answer, or is no Redis, leaves each process its own: a limit is no reason to refuse what the database could answer.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from urllib.parse import urlsplit

import redis
from redis.exceptions import RedisError

from worker.settings import Settings

log = logging.getLogger(__name__)

CONNECT_SECONDS = 0.5

DOWN_SECONDS = 5.0
"""A broker that did not answer is not asked for so long."""

MAX_LOCAL = 10_000

PREFIX = "tomosim:rate:"

# Of a bucket it keeps when it will be full again, in milliseconds of the server's clock; returns those to wait.
_TAKE = """
local time = redis.call('TIME')
local now = time[1] * 1000 + time[2] / 1000
local interval, burst = tonumber(ARGV[1]), tonumber(ARGV[2])
local full = math.max(tonumber(redis.call('GET', KEYS[1]) or 0), now) + interval
local wait = full - now - burst * interval
if wait > 0 then return math.ceil(wait) end
redis.call('SET', KEYS[1], string.format('%.3f', full), 'PX', math.ceil(full - now) + 1)
return 0
"""


class Rates:
    """The buckets. clock: seconds, of those of this process."""

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self.per_second = settings.rate_per_second
        self.burst = settings.rate_burst
        self.clock = clock
        self._full: dict[str, float] = {}
        self._down_until = -math.inf
        url = _redis_url(settings.resolved_broker_url)
        self._redis = (
            redis.Redis.from_url(url, socket_timeout=CONNECT_SECONDS, socket_connect_timeout=CONNECT_SECONDS)
            if url
            else None
        )
        self._take = self._redis.register_script(_TAKE) if self._redis is not None else None

    def take(self, name: str) -> float:
        """Takes one request from a bucket: 0, or the seconds until there is one again."""
        if not self.per_second:
            return 0.0
        if self._take is not None and self.clock() >= self._down_until:
            try:
                return float(self._take(keys=[PREFIX + name], args=[1000 / self.per_second, self.burst])) / 1000
            except RedisError as error:
                self._down_until = self.clock() + DOWN_SECONDS
                log.warning("rates are counted by each process alone", extra={"error": repr(error)})
        return self._take_locally(name)

    def close(self) -> None:
        """Ends the connections."""
        if self._redis is not None:
            self._redis.close()

    def _take_locally(self, name: str) -> float:
        now = self.clock()
        if len(self._full) > MAX_LOCAL:
            self._full = {key: full for key, full in self._full.items() if full > now}
        interval = 1 / self.per_second
        full = max(self._full.get(name, now), now) + interval
        wait = full - now - self.burst * interval
        if wait > 0:
            return wait
        self._full[name] = full
        return 0.0


def _redis_url(broker: str) -> str | None:
    """The broker's URL as redis-py wants it; None where it is another kind of broker."""
    parts = urlsplit(broker)
    if parts.scheme == "redis+socket":
        return f"unix://{parts.path}"
    return broker if parts.scheme in ("redis", "rediss") else None
