"""DICOMweb on a volume of full size (2304 x 1920 x 60, 531 MB): times and the memory of the server.

    python -m bench.dicomweb [--rounds 5]

A server process of its own on a free loopback port and one client, one request at a time; medians over the rounds.
Memory: how much the server's resident set grew beyond what it was after its first search. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

import httpx
import numpy as np

from simcore import dicom
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.store.store import Store
from tests.support.ports import free_port
from tests.support.servers import answers, end
from tests.support.waiting import wait_for
from worker.records.database import connect
from worker.records.jobs import Jobs
from worker.records.schema import prepare
from worker.settings import Settings

ROWS, COLUMNS, SLICES = 2304, 1920, 60
MEGABYTE = 1e6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=".") as folder:
        settings = Settings.load(data_folder=Path(folder) / "data", port=free_port())
        _add_case(settings, Path(folder) / "files")
        with _server(settings) as (client, process):
            print(json.dumps(_measure(client, process, args.rounds)))
    return 0


def _measure(client: httpx.Client, process: int, rounds: int) -> dict[str, float]:
    volume = _volume(client)
    before = _resident(process)
    numbers = range(1, SLICES + 1)

    def frames() -> None:
        for number in numbers:
            assert len(client.get(f"{volume}/frames/{number}").content) > 2 * ROWS * COLUMNS

    def whole() -> None:
        with client.stream("GET", volume, headers={"Accept": "application/dicom"}) as answer:
            assert sum(len(piece) for piece in answer.iter_bytes()) > 2 * ROWS * COLUMNS * SLICES

    seconds = {
        name: _median(run, rounds)
        for name, run in {
            "search": lambda: client.get("studies?limit=100").raise_for_status(),
            "metadata": lambda: client.get(f"{volume}/metadata").raise_for_status(),
            "frames": frames,
            "whole": whole,
            "rendered": lambda: client.get(f"{volume}/frames/30/rendered").raise_for_status(),
            "thumbnail": lambda: client.get(f"{volume}/thumbnail").raise_for_status(),
        }.items()
    }
    return {
        "search_ms": round(1e3 * seconds["search"], 1),
        "metadata_ms": round(1e3 * seconds["metadata"], 1),
        "frames_per_s": round(SLICES / seconds["frames"], 1),
        "MBps": round(2 * ROWS * COLUMNS * SLICES / MEGABYTE / seconds["whole"], 1),
        "rendered_ms": round(1e3 * seconds["rendered"], 1),
        "thumbnail_ms": round(1e3 * seconds["thumbnail"], 1),
        "resident_MB": round(before / MEGABYTE, 1),
        "growth_MB": round((_peak(process) - before) / MEGABYTE, 1),
        "rounds": rounds,
    }


def _median(run: Callable[[], object], rounds: int) -> float:
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def _volume(client: httpx.Client) -> str:
    """The address of the volume."""
    (instance,) = client.get("instances?SOPClassUID=1.2.840.10008.5.1.4.1.1.13.1.3").raise_for_status().json()
    return str(instance["00081190"]["Value"][0])


def _add_case(settings: Settings, folder: Path) -> None:
    """A case that succeeded, with files of full size."""
    random = np.random.default_rng(1)
    noise = random.integers(500, 16000, (ROWS, COLUMNS), dtype=np.uint16)
    angles = np.deg2rad(np.linspace(-25.0, 25.0, 15))
    sources = np.stack([0 * angles, 660.0 * np.sin(angles), 660.0 * np.cos(angles)], axis=1)
    geometry = AcquisitionGeometry(
        np.rad2deg(angles), sources, Detector(ROWS, COLUMNS, 0.1), 0 * angles, 0.0, 660.0, 20.0
    )
    labels = np.zeros((60, 100, 50), np.uint8)
    labels[10:50, 20:80, :40] = 1
    case = dicom.CaseDescription("0123456789abcdef" * 4, 1, "bench", 20.0)
    stack = ProjectionStack(np.stack([np.roll(noise, k) for k in range(15)]), 16000.0, geometry)
    grid = Grid((SLICES, ROWS, COLUMNS), (0.1, 0.1, 1.0), (0.0, -115.2, 20.0))
    volume = Volume(np.stack([np.roll(noise, k) for k in range(SLICES)]), grid, 1e-5, 0.0)
    phantom = Phantom(labels, Grid((60, 100, 50), (2.0, 2.0, 1.0), (0.0, -100.0, 0.0)))
    compression = Compression(np.zeros((4, 3)), (0.0, 60.0), 100.0, "converged")
    names = dicom.export(folder, dicom.ExportSpec(), case, stack, volume, phantom, compression).names
    store = Store(settings.store_folder)
    engine = connect(settings.resolved_database_url)
    prepare(engine)
    jobs = Jobs(engine)
    identifier = jobs.create({}, {}).id
    jobs.claim(identifier, "bench")
    files = {name: asdict(store.add(folder / name)) for name in names}
    jobs.succeed(identifier, "bench", {"files": files, "stages": []})
    engine.dispose()


@contextmanager
def _server(settings: Settings) -> Iterator[tuple[httpx.Client, int]]:
    environment = {**os.environ, **settings.environment()}
    process = subprocess.Popen([sys.executable, "-m", "api"], env=environment, stdout=sys.stderr)
    client = httpx.Client(base_url=f"http://127.0.0.1:{settings.port}/dicomweb/", timeout=120)
    try:
        wait_for(lambda: process.poll() is not None or answers(f"http://127.0.0.1:{settings.port}/livez"), "the start")
        assert process.poll() is None, "the server ended"
        yield client, process.pid
    finally:
        client.close()
        end(process)


def _resident(process: int) -> int:
    return _status(process, "VmRSS")


def _peak(process: int) -> int:
    return _status(process, "VmHWM")


def _status(process: int, name: str) -> int:
    """A size in /proc/<process>/status, bytes."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(f"{name}:"))


if __name__ == "__main__":
    sys.exit(main())
