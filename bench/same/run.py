"""Two revisions of the program on one machine: are the bytes of every stage the same, and how long does each take?

    python -m bench.same REVISION [OTHER] [--rounds 3] [--case NAME ...] [--preset NAME ...] [--keep FOLDER]

OTHER is the working tree as it stands where not given. Each revision is checked out into a worktree of its own (below
``--keep``, else for as long as this runs; compiled kernels live there) and runs in a process of its own, in turns with
the other, so that other load of the machine meets both. Cases: those of tests/golden of the working tree, and presets.
fTetWild gives another mesh each time, so the mesh of the first revision is handed to the second.

``seconds``: medians over the rounds, after one that is not counted; ``ratio``: median of the ratios of the rounds.
Ends with 1 where bytes differ. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self, cast

from bench.support.timing import Stolen
from simcore import presets
from simcore.store.store import Store
from tests.golden.cases import CASES, brief

ROOT = Path(__file__).parents[2]
DRIVER = Path(__file__).with_name("driver.py")
Stages = dict[str, dict[str, Any]]


class Revision:
    """A process that runs cases with the program in ``tree``, on a store of its own."""

    def __init__(self, name: str, tree: Path, store: Path) -> None:
        self.name = name
        self.store = store
        self._process = subprocess.Popen(
            [sys.executable, str(DRIVER), str(store)],
            cwd=tree,
            env={**os.environ, "PYTHONPATH": str(tree)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, spec: dict[str, Any]) -> Stages:
        """Every stage but a mesh that is not reproducible, anew: {stage: seconds, outputs, key, version, report}."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(spec) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise SystemExit(f"{self.name} could not run the case (see above)")
        stages: Stages = json.loads(answer)
        return stages

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision")
    parser.add_argument("other", nargs="?", help="the working tree where not given")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--case", action="append", choices=list(CASES), help="all of tests/golden where not given")
    parser.add_argument("--preset", action="append", default=[], choices=presets.names())
    parser.add_argument("--keep", type=Path, help="folder in which worktrees stay for a next run")
    args = parser.parse_args()
    names = args.case or ([] if args.preset else list(CASES))
    with contextlib.ExitStack() as open_until_end:
        folder = Path(open_until_end.enter_context(tempfile.TemporaryDirectory()))
        where = (args.keep or folder).absolute()
        trees = {
            revision: open_until_end.enter_context(worktree(revision, where, keep=args.keep is not None))
            for revision in dict.fromkeys((args.revision, args.other))
        }
        stores = [folder / "first", folder / "second"]
        titles = [args.revision, args.other or "working tree"]
        cases = {name: specification(name, stores) for name in names} | {
            name: brief(presets.get(name)) for name in args.preset
        }
        first, second = (
            open_until_end.enter_context(Revision(title, trees[revision], store))
            for title, revision, store in zip(titles, (args.revision, args.other), stores, strict=True)
        )
        with Stolen() as stolen:
            results = {name: compare(name, spec, first, second, args.rounds) for name, spec in cases.items()}
    same = all(stage["same"] for stages in results.values() for stage in stages.values())
    print(json.dumps({"revisions": titles, "same": same, "stolen": stolen.share, "cases": results}))
    return 0 if same else 1


@contextlib.contextmanager
def worktree(revision: str | None, folder: Path, keep: bool) -> Iterator[Path]:
    """Where a revision is checked out; the folder of this program without one. keep: it stays there."""
    if revision is None:
        yield ROOT
        return
    git = ["git", "-C", str(ROOT)]
    parsed = subprocess.run([*git, "rev-parse", "--verify", f"{revision}^{{commit}}"], capture_output=True, text=True)
    if parsed.returncode:
        raise SystemExit(f"{revision} is no revision of this repository")
    tree = folder / parsed.stdout[:12]
    if not tree.exists():
        folder.mkdir(parents=True, exist_ok=True)
        subprocess.run([*git, "worktree", "add", "--quiet", "--detach", str(tree), revision], check=True)
    try:
        yield tree
    finally:
        if not keep and tree.exists():  # another name of the same revision may have had it
            subprocess.run([*git, "worktree", "remove", "--force", str(tree)], check=True)


def specification(name: str, stores: list[Path]) -> dict[str, Any]:
    """A case of tests/golden as JSON; an uploaded volume is put into both stores."""
    spec, _ = (CASES[name](Store(store, min_free_bytes=0)) for store in stores)
    return cast(dict[str, Any], brief(spec))


def compare(name: str, spec: dict[str, Any], first: Revision, second: Revision, rounds: int) -> dict[str, Any]:
    """A table, and {stage: same bytes?, files that differ, seconds of both, ratio of the second to the first}."""
    runs: list[tuple[Stages, Stages]] = []
    for turn in range(rounds + 1):
        stages = first.run(spec)
        if turn == 0 and spec.get("mesh", {}).get("kind", "tetwild") == "tetwild":
            hand_over_mesh(first.store, second.store)
        runs.append((stages, second.run(spec)))
    print(f"{name:22} {'bytes':10} {first.name[:12]:>12} {second.name[:12]:>12}  ratio")
    results = {}
    for stage in {**runs[0][0], **runs[0][1]}:
        results[stage] = row = compared(stage, runs)
        seconds = "".join(f" {s:11.4f}s" for s in row["seconds"])
        print(f"  {stage:20} {'same' if row['same'] else 'DIFFERENT':10}{seconds}  {row['ratio']:.3f}", flush=True)
        for line in row["differing"]:
            print(f"    {line}")
    return results


def compared(stage: str, runs: list[tuple[Stages, Stages]]) -> dict[str, Any]:
    """See ``compare``."""
    if any(stage not in stages for stages in runs[0]):
        return {"same": False, "differing": ["only one of the two has it"], "seconds": [], "ratio": float("nan")}
    first, second = (stages[stage] for stages in runs[0])
    differing = [f"{what}: {first[what]} and {second[what]}" for what in ("version",) if first[what] != second[what]]
    outputs = first["outputs"], second["outputs"]
    differing += [n for n in sorted({*outputs[0], *outputs[1]}) if outputs[0].get(n) != outputs[1].get(n)]
    pairs = [(a[stage]["seconds"], b[stage]["seconds"]) for a, b in runs[1:]] or [(first["seconds"], second["seconds"])]
    return {
        "same": not differing,
        "differing": differing,
        "seconds": [round(statistics.median(side), 4) for side in zip(*pairs, strict=True)],
        "ratio": round(statistics.median(b / max(a, 1e-9) for a, b in pairs), 4),
    }


def hand_over_mesh(source: Path, target: Path) -> None:
    """Copies the record of every mesh, and its files, from one store to another."""
    for path in (source / "stages").rglob("*.json"):
        record = json.loads(path.read_bytes())
        if record["stage"] != "mesh":
            continue
        for ref in record["outputs"].values():
            name = Path("objects", ref["sha256"][:2], ref["sha256"])
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            if not (target / name).exists():
                shutil.copyfile(source / name, target / name)
        copy = target / path.relative_to(source)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
