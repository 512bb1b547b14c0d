"""The whole paper case, warm: seconds and peak memory of each stage, median of several runs.

    python -m bench.case [--preset paper-cup-c-20] [--runs 3] [--pause 0]

Every run is a fresh process on a store that holds nothing but the mesh of the first run (fTetWild alone takes longer
than all the rest, and gives another mesh each time). ``warm_process``: the pipeline in a process that has run it
before, as a worker's has. ``stolen``: shares of the processors that the machine's host gave to others; hosts that
lend processors by credit give them back after a ``pause``, seconds before every run.
Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from bench.support.timing import Stolen
from simcore import pipeline
from simcore.spec import SimulationSpec
from simcore.store.store import Store


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="paper-cup-c-20")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--pause", type=float, default=0.0)
    args = parser.parse_args()
    tomosim = [sys.executable, "-m", "tomosim"]
    subprocess.run([*tomosim, "warm-up"], check=True, stdout=sys.stderr)
    with tempfile.TemporaryDirectory(dir=".") as folder:
        root = Path(folder)
        spec = root / "spec.json"
        spec.write_bytes(subprocess.run([*tomosim, "presets", args.preset], check=True, capture_output=True).stdout)
        mesh_seconds = stage_seconds(simulate(tomosim, spec, root))["mesh"]
        runs, stolen = [], []
        for _ in range(args.runs):
            forget_all_but_mesh(root / "data" / "store")
            time.sleep(args.pause)
            with Stolen() as taken:
                start = time.perf_counter()
                manifest = simulate(tomosim, spec, root)
                runs.append((time.perf_counter() - start, manifest))
            stolen.append(taken.share)
        store = Store(root / "data" / "store")
        in_one_process = warm_runs(SimulationSpec.parse(spec.read_bytes()), store, args.runs, args.pause)
    stages = {
        name: round(statistics.median(stage_seconds(m)[name] for _, m in runs), 3)
        for name in stage_seconds(runs[0][1])
        if name != "mesh"
    }
    memory = {s["name"]: s["peak_memory_bytes"] for s in runs[-1][1]["stages"] if s["name"] != "mesh"}
    print(
        json.dumps(
            {
                "preset": args.preset,
                "runs": args.runs,
                "command_seconds_without_mesh": round(statistics.median(t for t, _ in runs), 2),
                "pipeline_seconds_without_mesh": round(statistics.median(m["seconds"] for _, m in runs), 2),
                "warm_process_seconds_without_mesh": round(statistics.median(t for t, _ in in_one_process), 2),
                "warm_process_runs": in_one_process,
                "stolen": stolen,
                "mesh_seconds": mesh_seconds,
                "stage_seconds": stages,
                "peak_memory_GB": round(max(memory.values()) / 1e9, 2),
            }
        )
    )
    return 0


def simulate(tomosim: list[str], spec: Path, root: Path) -> dict[str, Any]:
    subprocess.run(
        [*tomosim, "simulate", str(spec), "--out", str(root / "out"), "--data", str(root / "data")],
        check=True,
        stdout=sys.stderr,
        stderr=subprocess.DEVNULL,
    )
    manifest: dict[str, Any] = json.loads((root / "out" / "manifest.json").read_text())
    return manifest


def warm_runs(spec: SimulationSpec, store: Store, runs: int, pause_seconds: float = 0.0) -> list[tuple[float, float]]:
    """(seconds, share of the processors that was stolen) of the pipeline in a process that has run it before, as those
    of a worker have."""
    seconds = []
    for _ in range(runs + 1):
        forget_all_but_mesh(store.root)
        time.sleep(pause_seconds)
        with Stolen() as taken:
            start = time.perf_counter()
            pipeline.run(spec, store)
            took = time.perf_counter() - start
        seconds.append((round(took, 2), taken.share))
    return seconds[1:]


def stage_seconds(manifest: dict[str, Any]) -> dict[str, float]:
    return {s["name"]: s["seconds"] for s in manifest["stages"]}


def forget_all_but_mesh(store: Path) -> None:
    """Removes the records and the objects of every other stage."""
    kept: set[str] = set()
    for path in (store / "stages").rglob("*.json"):
        record = json.loads(path.read_bytes())
        if record["stage"] == "mesh":
            kept |= {ref["sha256"] for ref in record["outputs"].values()}
        else:
            path.unlink()
    for path in (store / "objects").rglob("*"):
        if path.is_file() and path.name not in kept:
            path.unlink()


if __name__ == "__main__":
    sys.exit(main())
