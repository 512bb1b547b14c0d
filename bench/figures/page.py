"""docs/figures.md"""

from __future__ import annotations

from typing import Any

from bench.figures.insertion import AWAY, BEAD_RADIUS, DISK_HEIGHT, DISK_RADIUS, Inserted, Outcome
from bench.figures.resolution import FREQUENCIES
from simcore.core.tissues import Tissue


def page(outcomes: list[Outcome], objects: list[Inserted], edge: dict[str, Any], beads: dict[str, Any]) -> str:
    """The page with its tables and what they say."""
    of = {(o.angular_range, o.views): o for o in outcomes}
    few, usual, many = of[40.0, 7], of[40.0, 15], of[40.0, 30]
    narrow = of[20.0, 15]
    disks = sum(thing.tissue == Tissue.MASS for thing in objects)
    return "\n".join(
        [
            "# Figures 5 and 6 of the paper, and its section 5.4",
            "",
            "Made by `python -m bench.figures`: cup C, 700 ml, the acquisitions of the paper, its monoenergetic "
            "projections without scatter, noise and detector blur, filtered back-projection.",
            "",
            "## Figure 5: projections at five tube angles, 20 % compression",
            "",
            "![Projections at -20, -10, 0, 10 and 20 degrees](images/figure5.png)",
            "",
            "Line integrals, one window. Chest wall on the left; the tube travels along the vertical axis, from top "
            "to bottom, so the shadow moves up. The whole height of the detector is shown.",
            "",
            "## Figure 6: the slice at mid height",
            "",
            "![Slices of 7, 11, 13, 15 and 30 views at 20 %, and of 15 views at 50 %](images/figure6.png)",
            "",
            "One window for 20 %, and one for 50 %. With more views over the same 40 degrees the ghosts of structures "
            "in other slices fade. At 50 % compartments are stretched to larger diameters and some others lie in the "
            "slice; as in the paper, compression does not enhance the contrast, since there is no scatter. The paper "
            "labels its panels range/number too but does not list them in its text; the range is fixed here, so that "
            "one thing changes at a time.",
            "",
            "![Details by number of views and by range](images/figure6_detail.png)",
            "",
            "Above: more views, fewer ghosts. Below: a wider range, more contrast. Same window.",
            "",
            "## More views, more contrast, fewer artefacts",
            "",
            f"{disks} disks of soft-tissue lesion (diameter {2 * DISK_RADIUS:g} mm, height {DISK_HEIGHT:g} mm) and "
            f"{len(objects) - disks} calcified beads (diameter {2 * BEAD_RADIUS:g} mm) stand in fat at mid height of "
            "the breast compressed by 20 %. Contrast, noise (standard deviation of the breast in the ring around a "
            "disk) and their ratio are measured in the breast; spread and ghosts on the objects alone, which by "
            "linearity is exactly what they add. *Ghost*: largest value of a bead's shadow "
            f"{AWAY:g} mm or more away from it, and root mean square of a disk's, over the value of the object.",
            "",
            "![Shadow of a bead across the slices; contrast-to-noise ratio, noise, ghosts and spread against the "
            "number of views](images/figure_views.png)",
            "",
            "| range/views | disk contrast | anatomical noise | disk CNR | disk alone | ASF disk | ASF bead | "
            "bead y x x | bead ghost | disk ghost |",
            "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
            *(_row(o) for o in outcomes),
            "",
            "Contrast and noise in 1/m, widths (FWHM) in mm, ghosts in % of the object. Where the objects lie follows "
            "the mesh, which is not the same twice: noise and CNR then change by about 5 %, and the trends do not.",
            "",
            f"- From 7 to 30 views over 40 degrees the CNR rises from {few.disk_cnr:.2f} to {many.disk_cnr:.2f}, the "
            f"noise falls from {1e3 * few.background_noise:.1f} to {1e3 * many.background_noise:.1f} per m, and a "
            f"bead's ghost from {100 * few.bead_ghost:.0f} to {100 * many.bead_ghost:.0f} %, nearly as one over the "
            "number of views. The gain is in the noise: what is better seen is the contrast against a calmer "
            "background, not the value of the disk.",
            f"- The disk's own contrast falls slightly ({1e3 * few.disk_alone:.2f} to {1e3 * many.disk_alone:.2f} per "
            "m): every view stands for one angular step, so N views over a range R are weighted as R N / (N - 1).",
            f"- Contrast grows with the range: {1e3 * narrow.disk_alone:.2f} per m for 20 degrees, "
            f"{1e3 * usual.disk_alone:.2f} for 40, each with 15 views (true: 38.8), and depth resolution with it: "
            f"the bead spreads over {narrow.bead_spread_mm:.1f} and {usual.bead_spread_mm:.1f} mm.",
            "- Published widths of a small bead are about 4.5 mm for 50 degrees and 10 mm for 15 degrees, with the "
            "blur of a real detector and focal spot.",
            "",
            "## Transfer of the chain",
            "",
            "Slanted edge of 0.1 mm voxels in a projection (rays end at pixel centres: only the voxels blur), and "
            "|sinc| of a voxel's shadow:",
            "",
            "| | " + " | ".join(name.replace("_per_mm", " per mm") for name in edge) + " |",
            "| --- |" + " --- |" * len(edge),
            "| measured | " + " | ".join(f"{v['measured']:.3f}" for v in edge.values()) + " |",
            "| voxel | " + " | ".join(f"{v['voxel']:.3f}" for v in edge.values()) + " |",
            "",
            "Frequencies where the modulation of small beads in their slice falls to a half (y: tube travel, over its "
            "maximum, as a limited angle has no value at 0; detector of 0.1 mm):",
            "",
            "| | " + " | ".join(beads) + " |",
            "| --- |" + " --- |" * len(beads),
            "| along y [1/mm] | " + " | ".join(_half(v["half_along_y_per_mm"]) for v in beads.values()) + " |",
            "| along x [1/mm] | " + " | ".join(_half(v["half_along_x_per_mm"]) for v in beads.values()) + " |",
            "",
            "Published in-plane values along the tube travel are 1.1 to 1.8 per mm, with detector blur and a moving "
            "tube.",
            "",
        ]
    )


def _half(frequency: float | None) -> str:
    return f"> {FREQUENCIES[-1]:.1f}" if frequency is None else f"{frequency:.2f}"


def _row(o: Outcome) -> str:
    return (
        f"| {o.angular_range:g}°/{o.views} | {1e3 * o.disk_contrast:.2f} | {1e3 * o.background_noise:.2f} | "
        f"{o.disk_cnr:.2f} | {1e3 * o.disk_alone:.2f} | {o.disk_spread_mm:.1f} | {o.bead_spread_mm:.2f} | "
        f"{o.bead_width_y_mm:.2f} x {o.bead_width_x_mm:.2f} | {100 * o.bead_ghost:.1f} | {100 * o.disk_ghost:.1f} |"
    )
