"""Records the facts that have a reason to differ: of new cases, of changed cases, of stages whose version was raised.

    python -m tests.golden.record [--force] [CASE ...]

What still agrees stays as it is, so that another processor's last bits make no change. A result that differs without
a reason is refused; ``--force`` records it nevertheless (after a change of what is kept, in facts.py).
"""

from __future__ import annotations

import argparse
import sys
import tempfile

from simcore import mesh, phantom
from simcore.store.store import Store
from tests.golden import references
from tests.golden.cases import CASES, TINY
from tests.golden.references import Reference


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", default=[], help=", ".join(CASES))
    parser.add_argument("--force", action="store_true")
    args = parser.parse_args()
    if unknown := set(args.cases) - set(CASES):
        parser.error(f"no such case: {', '.join(sorted(unknown))}; there are: {', '.join(CASES)}")
    if not references.MESH.exists():
        references.write_mesh(mesh.build(phantom.generate(TINY.phantom, TINY.seed), TINY.mesh))
    with tempfile.TemporaryDirectory() as folder:
        store = Store(folder, min_free_bytes=0)
        refused = [name for name in args.cases or CASES if not record(name, store, args.force)]
    return 1 if refused else 0


def record(name: str, store: Store, force: bool) -> bool:
    """Records one case; False where a stage has changed without a reason."""
    now = references.run(name, store)
    definition, stored = references.read(name)
    stages, refused = {}, []
    for stage, facts in now.facts.items():
        reference, versions = stored.get(stage), references.versions_of(stage)
        fresh = Reference(versions, facts)
        if reference is None or force or definition != now.definition:
            stages[stage] = fresh
        elif not references.differences(reference.facts, facts):
            stages[stage] = Reference(versions, reference.facts)
        elif reference.versions != versions:
            stages[stage] = fresh
        else:
            stages[stage] = reference
            refused.append(references.complaint(stage, reference, facts))
    references.write(name, now.definition, stages)
    print(f"{name}: {'refused' if refused else 'recorded'}", *refused, sep="\n", file=sys.stderr)
    return not refused


if __name__ == "__main__":
    sys.exit(main())
