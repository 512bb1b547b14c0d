"""docs/verification.md and its figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from bench.verification.check import Check

INTRODUCTION = """# Verification of the compression

Made by `python -m bench.verification`. Each line compares one number of the solver with an exact solution, a law of
similarity, or another program. *Error* is relative, or absolute in the unit of the numbers where it says so.

- **Affine, uniaxial, tangent**: exact to rounding or to the tolerance that the solver was asked for.
- **Order of convergence**: a manufactured volume-preserving deformation with the body force that it needs.
- **Cook's membrane**: nearly incompressible bending; the reference is Taylor-Hood by scikit-fem (published: 6.9).
- **Hertz**: the body is a half space only in the limit of small contact, to which the ratio is extrapolated. Few
  nodes touch, and they touch one after the other: the ratio is not smooth.
- **Explicit relaxation**: the same weak form, brought to rest by damped motion in plain numpy.
- **scikit-fem**: the same weak form, assembled and solved by other code; contact nodes prescribed.
- **Skin, deep compression**: a stiff membrane must not make the force depend on the mesh; a whole cup C at 70 %.
- **Fixed wall**: force on a coarse and a fine mesh with the plates' edge, and how it grows without one.
- **Bending plates**: against Plexiglas meshed with quadratic bricks (scikit-fem), and against rigid plates.
- **CalculiX, same energy**: contact prescribed, its own elements, C3D10, on the same nodes, as its linear tetrahedra
  lock. Discretisations differ, so the difference is followed to small elements. Its volumetric energy, kappa/2
  (J - 1)^2, is not ours and changes the force by 0.07 %; here ours has it too. Its forces were made by `--long`.
- **CalculiX**: with our own energy; contact prescribed, and its own face-to-face contact.
"""


@dataclass(frozen=True)
class Curves:
    """What the figure shows. manufactured: {nu: [(size, error)]}. cook: (reference, [(cells, tip)]).
    hertz: [(relative contact radius, ratio)]. refinement: [(tetrahedra, force)]."""

    manufactured: dict[float, list[tuple[float, float]]]
    cook: tuple[float, list[tuple[int, float]]]
    hertz: list[tuple[float, float]]
    refinement: list[tuple[int, float]]


def page(checks: Sequence[Check], notes: Sequence[str]) -> str:
    lines = [
        INTRODUCTION,
        f"{sum(c.passed for c in checks)} of {len(checks)} hold.",
        *notes,
        "",
        "| | what | expected | got | error | allowed | |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    group = ""
    for c in checks:
        name, group = ("" if c.group == group else c.group), c.group
        kind = "" if c.kind == "relative" else f" {c.kind}"
        lines.append(
            f"| {name} | {c.what} | {c.expected} | {c.got} | {c.error:.1e}{kind} | {c.tolerance:.1g} | "
            f"{'holds' if c.passed else '**fails**'} |"
        )
    return "\n".join([*lines, "", "![Convergence](images/verification.png)", ""])


def figure(curves: Curves, path: Path) -> None:
    """Four panels: manufactured solution, Cook's membrane, Hertz, plate force."""
    plt.rcParams.update({"font.size": 8, "axes.grid": True, "grid.alpha": 0.3})
    sheet, panels = plt.subplots(1, 4, figsize=(13, 3.2), layout="constrained")
    for nu, values in curves.manufactured.items():
        panels[0].loglog(*zip(*values, strict=True), "o-", label=f"nu = {nu}")
    size, error = curves.manufactured[0.475][-1]
    ends = [size, curves.manufactured[0.475][0][0]]
    panels[0].loglog(ends, [0.7 * error * (h / size) ** 2 for h in ends], "k:", label="order 2")
    panels[0].set(title="Manufactured solution", xlabel="element size [mm]", ylabel="relative error of displacement")
    panels[0].legend()
    reference, tips = curves.cook
    panels[1].semilogx(*zip(*tips, strict=True), "o-", base=2, label="ours")
    panels[1].axhline(reference, color="k", ls=":", label="Taylor-Hood")
    panels[1].set(title="Cook's membrane, nu = 0.4999", xlabel="cells along a side", ylabel="tip [mm]")
    panels[1].legend()
    panels[2].plot(*zip(*curves.hertz, strict=True), "o-")
    panels[2].axhline(1, color="k", ls=":")
    panels[2].set(title="Hertz", xlabel="contact radius / half width", ylabel="force / Hertz", xlim=(0, None))
    panels[3].semilogx(*zip(*curves.refinement, strict=True), "o-")
    panels[3].set(title="Cup C at 50 %", xlabel="tetrahedra", ylabel="plate force [N]")
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.savefig(path, dpi=90)
    plt.close(sheet)
