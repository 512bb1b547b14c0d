"""Times of two or more rivals in one run, in turns, so that other load of the machine meets all of them."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STAT = Path("/proc/stat")

Contender = Callable[[], Callable[[], Any]]
"""Prepares what is not timed, and returns what is."""


@dataclass(frozen=True)
class Timing:
    """Medians over the rounds. wall_s: elapsed; cpu_s: of all threads of this process."""

    wall_s: float
    cpu_s: float
    result: Any


def in_turns(contenders: dict[str, Contender], rounds: int) -> dict[str, Timing]:
    """Every contender once in each round; a round more comes first, which loads compiled code and is not counted."""
    wall: dict[str, list[float]] = {name: [] for name in contenders}
    cpu: dict[str, list[float]] = {name: [] for name in contenders}
    results: dict[str, Any] = {}
    for turn in range(rounds + 1):
        for name, prepare in contenders.items():
            if turn == 0 and rounds > 1 and name.startswith("peer"):
                continue
            run = prepare()
            start, start_cpu = time.perf_counter(), time.process_time()
            results[name] = run()
            if turn > 0:
                wall[name].append(time.perf_counter() - start)
                cpu[name].append(time.process_time() - start_cpu)
            del run
    return {
        name: Timing(statistics.median(wall[name]), statistics.median(cpu[name]), results[name]) for name in contenders
    }


def machine_load() -> float:
    """Processes that wanted to run during the last minute, this one among them."""
    return round(os.getloadavg()[0], 1)


class Stolen:
    """What share of its processors a virtual machine asked for and did not get, while this was open (Linux; elsewhere
    0). Times are worth nothing where it is not small."""

    share = 0.0

    def __enter__(self) -> Stolen:
        self._start = _ticks()
        return self

    def __exit__(self, *_: object) -> None:
        busy, stolen = (now - then for now, then in zip(_ticks(), self._start, strict=True))
        self.share = round(stolen / max(busy + stolen, 1), 3)


def _ticks() -> tuple[int, int]:
    """(busy, stolen) of all processors, 1/100 s."""
    try:
        user, nice, system, _, _, irq, softirq, steal = map(int, STAT.read_text().split("\n")[0].split()[1:9])
    except (OSError, ValueError):
        return 0, 0
    return user + nice + system + irq + softirq, steal
