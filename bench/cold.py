"""The first case of an installation that has compiled nothing, and the second.

    python -m bench.cold [--preset tiny] [--against REVISION]

Each case is a fresh process (``tomosim simulate``) on a store of its own; compiled kernels go to an empty folder.
``--against``: the same with another revision, before and after this one, on the same machine: of its two first cases
the mean is taken. Processor seconds are those of all processes together: on a machine that others use too they tell
more. Last line: one JSON object, first_case_seconds and second_case_seconds among others.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from bench.same.run import ROOT, worktree
from bench.support.timing import Stolen, machine_load
from simcore import presets


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="tiny", choices=presets.names())
    parser.add_argument("--against", metavar="REVISION")
    args = parser.parse_args()
    with Stolen() as stolen, tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        if args.against is None:
            figures = first_and_second(ROOT, args.preset, root / "now")
        else:
            with worktree(args.against, root, keep=False) as tree:
                others = [first_and_second(tree, args.preset, root / "before")]
                figures = first_and_second(ROOT, args.preset, root / "now")
                others.append(first_and_second(tree, args.preset, root / "after"))
            first = statistics.mean(other["first_case_seconds"] for other in others)
            figures["against"] = {"revision": args.against, "first_case_seconds": round(first, 2), "runs": others}
            figures["ratio"] = round(figures["first_case_seconds"] / first, 3)
    print(json.dumps({**figures, "preset": args.preset, "load": machine_load(), "stolen": stolen.share}))
    return 0


def first_and_second(tree: Path, preset: str, folder: Path) -> dict[str, Any]:
    """Seconds of the whole commands."""
    folder.mkdir()
    seconds, processor_seconds = [], []
    environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(folder / "kernels")}
    tomosim = [sys.executable, "-m", "tomosim"]
    spec = folder / "spec.json"
    printed = subprocess.run([*tomosim, "presets", preset], check=True, cwd=tree, env=environment, capture_output=True)
    spec.write_bytes(printed.stdout)
    for case in ("first", "second"):
        start, start_of_processor = time.perf_counter(), _processor_seconds()
        out, data = str(folder / case / "out"), str(folder / case / "data")
        subprocess.run(
            [*tomosim, "simulate", str(spec), "--out", out, "--data", data],
            check=True,
            cwd=tree,
            env=environment,
            stdout=sys.stderr,
        )
        seconds.append(round(time.perf_counter() - start, 2))
        processor_seconds.append(round(_processor_seconds() - start_of_processor, 2))
        print(f"{tree.name}, {case} case: {seconds[-1]} s", file=sys.stderr, flush=True)
    return {
        "first_case_seconds": seconds[0],
        "second_case_seconds": seconds[1],
        "first_case_processor_seconds": processor_seconds[0],
        "second_case_processor_seconds": processor_seconds[1],
    }


def _processor_seconds() -> float:
    """Of all processes that this one has started and that have ended, and of theirs."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main())
