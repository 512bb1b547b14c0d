"""When a request is sent again, and after how long."""

from __future__ import annotations

import random
from dataclasses import dataclass

import httpx

from tomosim.client import errors

NOT_TAKEN = (429, 502, 503, 504)
"""Answers to requests that were not carried out."""


IN_PROGRESS = "idempotency-in-progress"
"""Code of the answer to a request that was sent before and is still under way."""


def _not_taken(response: httpx.Response) -> bool:
    if response.status_code in NOT_TAKEN:
        return True
    return response.status_code == 409 and errors.from_response(response).code == IN_PROGRESS


@dataclass(frozen=True)
class Retrying:
    """Pauses grow from ``first_seconds`` by doubling, up to ``longest_seconds``, each between half and all of it.

    attempts: times a request is sent before its error is raised; 1: never again.
    longest_wait_seconds: where the service asks for a longer pause (Retry-After), the error is raised at once.
    """

    attempts: int = 6
    first_seconds: float = 0.5
    longest_seconds: float = 10.0
    longest_wait_seconds: float = 60.0

    def after_response(self, number: int, response: httpx.Response) -> float | None:
        """Seconds until the request is sent again after its ``number``-th answer; None: not again."""
        if number >= self.attempts or not _not_taken(response):
            return None
        pause = errors.retry_after(response)
        if pause is not None:
            return pause if pause <= self.longest_wait_seconds else None
        return self.pause(number)

    def after_error(self, number: int, error: httpx.HTTPError, repeatable: bool) -> float | None:
        """As ``after_response``, where no answer came.

        repeatable: whether it does no harm where the request was carried out and only its answer was lost.
        """
        never_arrived = isinstance(error, httpx.ConnectError | httpx.ConnectTimeout | httpx.PoolTimeout)
        if number >= self.attempts or not (repeatable or never_arrived):
            return None
        if not isinstance(error, httpx.TransportError):
            return None
        return self.pause(number)

    def pause(self, number: int) -> float:
        """Seconds after the ``number``-th failure."""
        longest = min(self.longest_seconds, self.first_seconds * 2.0 ** (number - 1))
        return float(random.uniform(longest / 2, longest))
