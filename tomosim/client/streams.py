"""Server-sent events of a case, line by line."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class CaseEvent:
    """Something that happened to a case.

    sequence: grows with time. kind: "state" or "progress". data: what the service says of it: ``state`` and
    ``attempt``, or ``stage``, ``stages_done``, ``stages_total``, ``fraction`` and ``message``.
    """

    sequence: int
    kind: str
    data: dict[str, Any]


@dataclass
class EventParser:
    """Takes lines, gives events."""

    _fields: dict[str, list[str]] = field(default_factory=dict)

    def feed(self, line: str) -> CaseEvent | None:
        """The event that this line completes; None where it completes none."""
        if line:
            name, _, value = line.partition(":")
            self._fields.setdefault(name, []).append(value.removeprefix(" "))
            return None
        fields, self._fields = self._fields, {}
        if "data" not in fields or "id" not in fields:
            return None
        data = json.loads("\n".join(fields["data"]))
        return CaseEvent(int(fields["id"][-1]), fields.get("event", ["message"])[-1], data)
