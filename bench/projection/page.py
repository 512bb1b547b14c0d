"""docs/projection_accuracy.md from what bench.projection measured."""

from __future__ import annotations

import math
from typing import Any

MEASURED = """# Accuracy of the projections

Made by `python -m bench.projection`: a ball of fat of 46 mm with 25 masses in capsules of 0.4 mm, whose line integrals
have closed forms, seen from a tube angle of 20 degrees. Errors are rms over rays through it.

## Order of convergence

Voxels shrink, the samples of the paper's method with them (0.45 voxels). Both methods converge to the truth, and to one
another, with the first order that voxels at curved borders allow; order: log2 of the ratio to the row above.

| voxel, mm | exact - truth | order | trilinear - truth | order | trilinear - exact | order |
| --- | --- | --- | --- | --- | --- | --- |
"""

STEPS = """
The step alone shrinks (0.8 mm voxels), against steps of 0.005 voxels:

| step, voxels | error | order |
| --- | --- | --- |
"""

PIXELS = """
The paper's step of 0.45 voxels costs far less than the voxels themselves; Shannon's bound is kept with room to spare.

## Voxels, rays, partial volume

Relative error of the intensity of 0.2 mm pixels against the mean over 8 x 8 closed-form rays. *Partial volume*: every
voxel has the mean attenuation of 4 x 4 x 4 labels in it, in 256 steps.

| voxel, mm | form | rays a pixel | rms | 99.9 % below |
| --- | --- | --- | --- | --- |
"""

DECISION = """
So the next thing to buy is rays, then voxels. With 2 x 2 rays partial volume takes {partial:.0%} off the error at
0.2 mm; labels of 0.1 mm take {finer:.0%}, and a map of fractions can only be made from such finer labels, of which it
keeps less than they say. What it would save is memory and time, and these are no obstacle: the whole case at 0.1 mm
takes half a minute and 4 GB ([performance.md](performance.md)). Partial-volume labels are therefore not offered;
`phantom.voxel_mm` 0.1 and `rays_per_pixel_edge` 2 are.

## Several maps

Four maps: {maps_s:.3f} s of CPU time, one map {one_s:.3f} s; largest difference {largest_difference:.1e}. Where the
detector is at rest each map is a pass over the borders between tissues, found once: at the paper's size that is 1.5
times faster than all maps in one pass over the voxels (0.45 and 0.65 s), which serves turning detectors; on this small
scene it is slower.
"""


def page(result: dict[str, Any]) -> str:
    lines = [MEASURED.rstrip("\n")]
    voxels = result["voxels"]
    for n, row in enumerate(voxels):
        cells = []
        for name in ("exact", "trilinear", "difference"):
            order = "" if n == 0 else f"{math.log2(voxels[n - 1][name] / row[name]):.2f}"
            cells.append(f"{row[name]:.4f} | {order}")
        lines.append(f"| {row['edge_mm']:g} | {' | '.join(cells)} |")
    lines.append(STEPS.rstrip("\n"))
    steps = result["steps"]
    for n, row in enumerate(steps):
        order = "" if n == 0 else f"{math.log2(steps[n - 1]['error'] / row['error']):.2f}"
        lines.append(f"| {row['step']:g} | {row['error']:.1e} | {order} |")
    lines.append(PIXELS.rstrip("\n"))
    of = {}
    for row in result["pixels"]:
        of[row["edge_mm"], row["form"], row["rays"]] = row["rms"]
        rays = f"{row['rays']} x {row['rays']}"
        lines.append(f"| {row['edge_mm']:g} | {row['form']} | {rays} | {row['rms']:.1e} | {row['p999']:.1e} |")
    coarse = of[0.2, "labels", 2]
    partial, finer = 1 - of[0.2, "partial volume", 2] / coarse, 1 - of[0.1, "labels", 2] / coarse
    lines.append(DECISION.rstrip("\n").format(partial=partial, finer=finer, **result["maps"]))
    return "\n".join(lines) + "\n"
