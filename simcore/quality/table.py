"""An analysis as a table for people."""

from __future__ import annotations

from collections.abc import Iterator

from simcore.core.artifacts import Report


def table(analysis: Report) -> str:
    """The report of ``analyse`` as plain text, at most 100 characters a line."""
    return "\n".join([*_projections(analysis["projections"]), "", *_volume(analysis["volume"]), "", *_checks(analysis)])


def _projections(views: list[Report]) -> Iterator[str]:
    first = views[0]
    yield (
        f"Projections: {len(views)} views; texture in {first['roi_pixels']} x {first['roi_pixels']} pixels "
        f"of {first['pixel_mm']:g} mm"
    )
    yield f"{'view':>5} {'angle':>8} {'beta':>6} {'+-':>6} {'ROIs':>5} {'lowest value':>13} {'stored as 0':>12}"
    for v in views:
        yield (
            f"{v['view'] + 1:>5} {v['angle_degrees']:>7.2f}° {_number(v['beta'], 2):>6} {_number(v['beta_std'], 2):>6} "
            f"{v['rois']:>5} {v['stored']['min']:>13.0f} {100 * v['clipped_low']:>10.2g} %"
        )


def _volume(volume: Report) -> Iterator[str]:
    x, y, z = volume["voxel_mm"]
    yield f"Volume: {volume['slices']} slices, voxels {x:g} x {y:g} x {z:g} mm, attenuation in 1/mm"
    for t in volume["texture"]:
        yield (
            f"  slice {t['slice'] + 1:>3}: beta {_number(t['beta'], 2)} +- {_number(t['beta_std'], 2)} "
            f"({t['rois']} ROIs of {t['roi_pixels']} pixels)"
        )
    for tissue, mean in volume["tissue_mean_per_mm"].items():
        if tissue in volume["tissue_ml"]:
            yield f"  {tissue:<14} {volume['tissue_ml'][tissue]:8.1f} ml   mean {mean:+.4f}"
    for name in ("gland_against_adipose", "mass_against_adipose"):
        if row := volume[name]:
            yield (
                f"  {name.replace('_', ' ')}: {row['difference_per_mm']:+.4f}, noise {row['noise_per_mm']:.4f}, "
                f"CNR {_number(row['cnr'], 2)}"
            )
    skin = volume["skin_line"]
    yield (
        f"  skin line: border {_number(skin.get('border_mm'), 2)} mm from the true one, "
        f"{_number(skin.get('overshoot_per_mm'), 4)} above the tissue below; "
        f"skin {_number(skin.get('thickness_mm'), 2)} mm"
    )
    for name, v in volume["values_per_mm"].items():
        if v:
            yield (
                f"  values in {name:<6}: min {v['min']:+.4f}, 1 % {v['p1']:+.4f}, median {v['p50']:+.4f}, "
                f"99 % {v['p99']:+.4f}, max {v['max']:+.4f}"
            )
    clipped = volume["clipped"]
    yield f"  clipped in the breast: {100 * clipped['low']:.2g} % low, {100 * clipped['high']:.2g} % high"


def _checks(analysis: Report) -> Iterator[str]:
    yield "Against published ranges"
    words = {True: "in range", False: "outside", None: "not measured"}
    for c in analysis["checks"]:
        unit = "" if c["unit"] == "1" else f" {c['unit']}"
        yield (
            f"  {c['quantity']:<21} {_number(c['value'], 2):>7}{unit:<3}  {c['low']:g} to {c['high']:g}: "
            f"{words[c['in_range']]} ({c['source']})"
        )


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
