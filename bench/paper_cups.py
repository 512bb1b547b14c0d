"""The paper's five cups at 20 and 50 % through ``tomosim simulate``; writes docs/paper_cups.md.

    python -m bench.paper_cups [--data DIR] [--cups a b c d dd]

Checks what the paper fixes: force of cup C at 50 %, growth of the force as volume^(2/3), volumes and glandularity.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from simcore.presets import CUPS, PERCENTS

PAGE = Path(__file__).parent.parent / "docs" / "paper_cups.md"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--cups", nargs="+", choices=list(CUPS), default=list(CUPS))
    args = parser.parse_args()
    rows = [run(cup, percent, args.data) for cup in args.cups for percent in PERCENTS]
    problems = check(rows)
    if len(args.cups) == len(CUPS):
        PAGE.write_text(page(rows))
    for problem in problems:
        print(f"not as it should be: {problem}", file=sys.stderr)
    print(json.dumps({"cases": rows, "problems": problems}))
    return 1 if problems else 0


def run(cup: str, percent: int, data: Path) -> dict[str, Any]:
    """One case through the command line; the numbers of its manifest."""
    name = f"paper-cup-{cup}-{percent}"
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        tomosim = [sys.executable, "-m", "tomosim"]
        spec = out / "spec.json"
        spec.write_bytes(subprocess.run([*tomosim, "presets", name], check=True, capture_output=True).stdout)
        subprocess.run(
            [*tomosim, "simulate", str(spec), "--out", str(out / "case"), "--data", str(data)],
            check=True,
            stdout=sys.stderr,
        )
        manifest = json.loads((out / "case" / "manifest.json").read_text())
    stages = {s["name"]: s for s in manifest["stages"]}
    results = manifest["results"]
    return {
        "preset": name,
        "cup": cup.upper(),
        "percent": percent,
        "asked_ml": CUPS[cup][0],
        "volume_ml": results["volume_ml"],
        "glandularity": results["glandularity"],
        "compartments": results["compartments"],
        "tets": results["tets"],
        "force_N": results["force_N"],
        "thickness_mm": results["thickness_mm"],
        "min_det_F": results["min_det_F"],
        "volume_change": results["volume_change"],
        "pressure_kPa": stages["fem"]["report"]["mean_pressure_kPa"],
        "seconds": round(sum(s["seconds"] for s in manifest["stages"]), 1),
        "seconds_without_mesh": round(sum(s["seconds"] for s in manifest["stages"] if s["name"] != "mesh"), 1),
        "peak_memory_GB": round(max(s["peak_memory_bytes"] for s in manifest["stages"]) / 1e9, 2),
    }


def check(rows: list[dict[str, Any]]) -> list[str]:
    """What does not hold, in words."""
    problems = []
    force = {(r["cup"], r["percent"]): r["force_N"] for r in rows}
    for r in rows:
        if abs(r["volume_ml"] / r["asked_ml"] - 1) > 0.01:
            problems.append(f"{r['preset']}: volume {r['volume_ml']:.1f} ml, asked {r['asked_ml']:g}")
        if abs(r["glandularity"] - 0.30) > 0.02:
            problems.append(f"{r['preset']}: glandularity {r['glandularity']:.3f}, asked 0.30")
    c50 = force.get(("C", 50))
    if c50 is not None and not 150 <= c50 <= 260:
        problems.append(f"cup C at 50 %: {c50:.1f} N, expected 150 to 260")
    for percent in PERCENTS:
        if ("A", percent) in force and ("DD", percent) in force:
            ratio = force["DD", percent] / force["A", percent]
            expected = (CUPS["dd"][0] / CUPS["a"][0]) ** (2 / 3)
            if abs(ratio / expected - 1) > 0.10:
                problems.append(f"DD/A at {percent} %: {ratio:.2f}, V^(2/3) gives {expected:.2f}")
    return problems


def page(rows: list[dict[str, Any]]) -> str:
    """docs/paper_cups.md"""
    force = {(r["cup"], r["percent"]): r["force_N"] for r in rows}
    expected = (CUPS["dd"][0] / CUPS["a"][0]) ** (2 / 3)
    lines = [
        "# The paper's cups, compressed",
        "",
        "Made by `make validate` (`python -m bench.paper_cups`): each line is one `tomosim simulate` of a preset. "
        "Homogeneous neo-Hookean breast, E = 60.6 kPa (6 alpha), nu = 0.475, rigid frictionless plates.",
        "",
        "| cup | compression | volume | glandularity | tetrahedra | force | mean pressure | thickness | min J | volume "
        "change |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {r['cup']} | {r['percent']} % | {r['volume_ml']:.1f} ml | {100 * r['glandularity']:.1f} % | "
        f"{r['tets']} | {r['force_N']:.1f} N | {r['pressure_kPa']:.2f} kPa | {r['thickness_mm']:.1f} mm | "
        f"{r['min_det_F']:.3f} | {100 * r['volume_change']:.2f} % |"
        for r in rows
    ]
    lines += [
        "",
        f"Force DD / A: V^(2/3) predicts {expected:.2f}; "
        + ", ".join(f"{force['DD', p] / force['A', p]:.2f} at {p} %" for p in PERCENTS)
        + ".",
    ]
    lines += [
        "",
        "The paper reports 17 N (smallest breast, 20 %) to 448 N (largest, 50 %), and clinical forces of 49 to 186 N. "
        "Its phantoms' shapes are not given; here every cup has the same proportions, so the forces grow as the "
        "contact area.",
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
