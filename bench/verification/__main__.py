"""Everything, into docs/verification.md and docs/images/verification.png; exit code 1 where a check fails.

    python -m bench.verification [--without-calculix] [--long] [--docs DIR]

CalculiX (Debian package calculix-ccx) takes minutes; where it is not installed the page says so. With --long it also
makes its forces on meshes of up to 88 000 tetrahedra anew, half an hour; else those kept beside this file are taken.
Last line: JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from bench.peers import calculix
from bench.verification import breast, calculix_ladder, cook, exact, plates, wall
from bench.verification.check import Check
from bench.verification.page import Curves, figure, page

DOCS = Path(__file__).parent.parent.parent / "docs"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--without-calculix", action="store_true")
    parser.add_argument("--long", action="store_true", help="run CalculiX on the fine meshes again")
    parser.add_argument("--docs", type=Path, default=DOCS)
    args = parser.parse_args()
    start = time.perf_counter()
    manufactured = exact.manufactured_orders()
    curves = Curves(manufactured, cook.tips(), exact.hertz_ratios(), breast.refinement())
    suites: list[Iterable[Check]] = [
        exact.affine_checks(),
        exact.uniaxial_checks(),
        exact.tangent_checks(),
        exact.manufactured_checks(manufactured),
        breast.refinement_checks(curves.refinement),
        cook.cook_checks(*curves.cook),
        exact.hertz_checks(curves.hertz),
        breast.similarity_checks(),
        breast.relaxation_checks(),
        breast.scikit_checks(),
        breast.skin_checks(),
        breast.deep_checks(),
        wall.wall_checks(),
        plates.plate_checks(),
        calculix_ladder.energy_checks(),
    ]
    notes = []
    if args.long and calculix.available():
        calculix_ladder.record(list(calculix_ladder.climb()))
    suites.append(calculix_ladder.ladder_checks(calculix_ladder.recorded()))
    if args.without_calculix or not calculix.available():
        notes.append("CalculiX was not installed or not asked for in this run.")
    else:
        suites.append(breast.calculix_checks())
    checks = []
    for suite in suites:
        for check in suite:
            print("holds" if check.passed else "FAILS", check.group, check.what, check.got, file=sys.stderr, flush=True)
            checks.append(check)
    (args.docs / "verification.md").write_text(page(checks, notes))
    figure(curves, args.docs / "images" / "verification.png")
    failed = [f"{c.group}: {c.what}" for c in checks if not c.passed]
    seconds = round(time.perf_counter() - start, 1)
    print(json.dumps({"checks": len(checks), "failed": failed, "seconds": seconds}))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
