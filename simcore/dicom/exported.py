"""What an export answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ExportedStudy:
    """Files that were written, and what their reader must know.

    names: relative to the folder. left_out: reason by the name of every file that is not there though a reader of the
    specification may expect it. notes: sentences about what the files do not show.
    """

    names: list[str]
    left_out: dict[str, str]
    notes: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        """What there is to tell, JSON-ready."""
        facts = {"left_out": self.left_out, "notes": list(self.notes)}
        return {name: value for name, value in facts.items() if value}
