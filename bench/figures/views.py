"""The figure of section 5.4: contrast and artefacts against the number of views."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from bench.figures.insertion import DEPTH, FAN, Outcome

SHOWN = (7, 11, 15, 30)
"""Numbers of views whose shadow of a bead is drawn, over 40 degrees."""


def draw(outcomes: list[Outcome], target: Path) -> None:
    """Above: the shadow of a bead across the slices; below: three measures against the number of views."""
    figure, axes = plt.subplots(2, len(SHOWN), figsize=(11, 7), layout="constrained")
    by_acquisition = {(o.angular_range, o.views): o for o in outcomes}
    for axis, views in zip(axes[0], SHOWN, strict=True):
        axis.imshow(
            by_acquisition[40.0, views].section, cmap="gray", vmin=-0.15, vmax=0.35, origin="lower",
            extent=(-FAN, FAN, -DEPTH, DEPTH), interpolation="antialiased",
        )  # fmt: skip
        axis.set(title=f"bead, 40°/{views}", xlabel="y [mm]", ylabel="z [mm]")
    panels = (
        ("disk_cnr", 1.0, "CNR of a 5 mm disk in the breast"),
        ("background_noise", 1e3, "anatomical noise [1/m]"),
        ("bead_ghost", 100.0, "largest ghost of a bead [%]"),
        ("bead_spread_mm", 1.0, "bead's ASF, FWHM [mm]"),
    )
    for axis, (name, scale, title) in zip(axes[1], panels, strict=True):
        for angular_range, marker in ((20.0, "v"), (30.0, "s"), (40.0, "o")):
            chosen = [o for o in outcomes if o.angular_range == angular_range]
            axis.plot(
                [o.views for o in chosen], [scale * getattr(o, name) for o in chosen],
                marker=marker, color="0.1", fillstyle="none" if angular_range < 40 else "full",
                linestyle={20.0: ":", 30.0: "--", 40.0: "-"}[angular_range], label=f"{angular_range:g}°",
            )  # fmt: skip
        axis.set(xlabel="views", title=title, xticks=(7, 11, 15, 30))
        axis.title.set_fontsize(9)
        axis.set_ylim(bottom=0)
    axes[1][0].legend(title="range", frameon=False)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=85, metadata={"Software": None})
    plt.close(figure)
