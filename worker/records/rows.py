"""What all rows on lease have, their events, and the errors of every repository."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tomosim_contract.names import FINAL_STATES, State

Json = dict[str, Any]


class NotFoundError(LookupError):
    """There is no such row; ``what`` says of which kind."""

    def __init__(self, identifier: str, what: str = "simulation") -> None:
        super().__init__(identifier)
        self.what = what


class StateError(Exception):
    """The row is in a state that does not allow what was asked; ``state`` is the one it is in."""

    def __init__(self, state: State) -> None:
        super().__init__(state)
        self.state = state


@dataclass(frozen=True)
class Leased:
    """What every row on lease has. Times: seconds since 1970."""

    id: str
    state: State
    revision: int
    created: float
    started: float | None
    finished: float | None
    attempt: int
    sent: float | None
    owner: str | None
    lease_until: float | None
    error: Json | None

    @property
    def is_final(self) -> bool:
        return self.state in FINAL_STATES


@dataclass(frozen=True)
class Event:
    """Something that happened to a row; ``sequence`` grows with time and may have gaps."""

    sequence: int
    at: float
    kind: str
    data: Json


NO_OWNER: Json = {"owner": None, "lease_until": None}
QUEUED: Json = {**NO_OWNER, "state": "queued", "sent": None}
