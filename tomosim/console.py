"""Progress for people: bars on a terminal, plain lines otherwise (a log, a pipe)."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Self, TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

if TYPE_CHECKING:
    from tomosim.client.streams import CaseEvent


class StageDisplay:
    """Shows the stages of one case on standard error. A context manager; call it as a pipeline's progress."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stderr
        self._bars: Progress | None = None
        if self._stream.isatty():
            self._bars = Progress(
                TextColumn("{task.description:<15}"),
                BarColumn(),
                TextColumn("{task.percentage:>4.0f} %"),
                TimeElapsedColumn(),
                TextColumn("{task.fields[message]}"),
                console=Console(file=self._stream),
            )
        self._tasks: dict[str, TaskID] = {}
        self._started: dict[str, float] = {}
        self._finished: set[str] = set()

    def __enter__(self) -> Self:
        if self._bars:
            self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        if self._bars:
            self._bars.stop()

    def __call__(self, stage: str, fraction: float, message: str, *, cached: bool = False) -> None:
        if stage in self._finished:
            return
        for earlier in set(self._started) - self._finished - {stage}:  # one that polls may miss the end of a stage
            self._show(earlier, 1.0, "done")
        self._show(stage, fraction, message, cached)

    def _show(self, stage: str, fraction: float, message: str, cached: bool = False) -> None:
        note = "from the store" if cached else message
        if fraction >= 1 and (cached or message == "done"):
            self._finished.add(stage)
        now = time.monotonic()
        first = stage not in self._started
        start = self._started.setdefault(stage, now)
        if self._bars:
            if stage not in self._tasks:
                self._tasks[stage] = self._bars.add_task(stage, total=1.0, message="")
            self._bars.update(self._tasks[stage], completed=fraction, message=note)
            if stage in self._finished:
                self._bars.stop_task(self._tasks[stage])
            return
        if stage in self._finished:
            self._line(f"{stage}: {note}" + ("" if cached else f" in {now - start:.1f} s"))
        elif first:
            self._line(f"{stage}: {message}")

    def show_event(self, event: CaseEvent) -> None:
        """Shows an event of a case that a service runs."""
        data = event.data
        if event.kind == "progress":
            cached = data["message"] == "from the store"
            self(data["stage"], float(data["fraction"]), data["message"], cached=cached)
        elif data.get("state") == "queued" and data.get("attempt"):
            reason = (data.get("reason") or {}).get("message", "its worker was lost or stopped")
            self._line(f"queued again after attempt {data['attempt']}: {reason}")
            self._finished.clear()

    def _line(self, text: str) -> None:
        print(text, file=self._stream, flush=True)
