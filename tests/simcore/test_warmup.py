"""Kernels compiled by several processes before the first case."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from simcore import warmup
from simcore.core.errors import SimulationError

COUNT = """
import sys
from numba.core import event
from simcore import pipeline, presets
from simcore.store.store import Store

class Compiled(event.Listener):
    def on_start(self, happening):
        print(happening.data["dispatcher"].py_func.__qualname__, file=sys.stderr)
    def on_end(self, happening):
        pass

event.register("numba:compile", Compiled())
pipeline.run(presets.get("tiny"), Store(sys.argv[1], min_free_bytes=0))
"""


def test_every_part_has_a_process_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[str] = []
    reports: list[tuple[str, float]] = []
    monkeypatch.setattr(warmup, "_in_a_process", started.append)
    warmup.compile_all(2, lambda part, fraction: reports.append((part, fraction)))
    assert sorted(started) == sorted(warmup.PARTS) == sorted(part for part, _ in reports)
    assert [round(fraction * len(reports)) for _, fraction in reports] == list(range(1, len(reports) + 1))
    assert set(warmup.OF_MOST_CASES) <= set(warmup.PARTS)


def test_a_part_that_fails_is_told() -> None:
    with pytest.raises(SimulationError, match=r"(?s)kernels of nonsense could not be compiled: .*KeyError: 'nonsense'"):
        warmup.compile_all(1, lambda part, fraction: None, ["nonsense"])


@pytest.mark.sweep
def test_a_case_finds_everything_compiled(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}

    def run(*arguments: str) -> str:
        ended = subprocess.run([sys.executable, *arguments], env=environment, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout + ended.stderr

    cold = "from simcore import warmup; print(warmup.is_cold())"
    assert run("-c", cold) == "True\n"
    assert "100%" in run("-m", "tomosim", "warm-up", "--processes", "2")
    assert run("-c", cold) == "False\n"
    assert run("-c", COUNT, str(tmp_path / "store")) == ""
