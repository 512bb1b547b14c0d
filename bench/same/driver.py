"""What ``bench.same`` runs in each of the two revisions; uses only what no revision may change.

python bench/same/driver.py STORE      (a specification a line in, the stages of its case a line out)
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path


def main() -> int:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever else is printed is no answer
    sys.path.pop(0)  # the folder of this file, which is that of another revision
    from simcore import pipeline
    from simcore.spec import SimulationSpec

    try:
        from simcore.store.store import Store
    except ModuleNotFoundError:  # a revision whose store was a file of simcore.core
        from simcore.core.store import Store  # type: ignore[import-not-found, no-redef]

    store = Store(sys.argv[1], min_free_bytes=0)
    for line in sys.stdin:
        spec = SimulationSpec.from_dict(json.loads(line))
        forget(Path(sys.argv[1]), keep_meshes=spec.mesh.kind == "tetwild")
        stages = pipeline.run(spec, store).manifest["stages"]
        print(json.dumps({s["name"]: s for s in stages}), file=answers, flush=True)
    return 0


def forget(store: Path, keep_meshes: bool) -> None:
    """Removes what makes a stage count as done."""
    for path in (store / "stages").rglob("*.json"):
        if not (keep_meshes and json.loads(path.read_bytes())["stage"] == "mesh"):
            path.unlink()


if __name__ == "__main__":
    sys.exit(main())
