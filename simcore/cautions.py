"""What a finished case should be read with: limits that its stages reached, from their reports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from simcore.core.advice import one_of, where
from simcore.core.artifacts import Report
from simcore.projection.spec import HIGHEST_OPEN_FIELD
from simcore.spec import SimulationSpec

FEWEST_STEPS = 100
"""Steps of a pixel value behind the thickest tissue below which rounding (0.5 steps) is told."""


def cautions(spec: SimulationSpec, reports: Mapping[str, Report]) -> list[str]:
    """One sentence each; none for a case that met no limit. reports: of the stages, by name."""
    return [
        *_of_phantom(reports.get("phantom", {})),
        *_of_compression(spec, reports.get("fem", {})),
        *_of_warp(reports.get("warp", {})),
        *_of_projections(spec, reports.get("projection", {})),
        *reports.get("detection", {}).get("remarks", ()),
        *_of_volume(spec, reports.get("reconstruction", {})),
    ]


def _of_phantom(report: Report) -> Iterator[str]:
    if number := report.get("dropped_pieces"):
        yield f"{number} pieces of the file that do not touch the breast are not in the phantom"
    if left_out := report.get("left_out_ml"):
        volumes = ", ".join(f"{ml:.3g} ml of {name}" for name, ml in left_out.items())
        yield f"tissue of the file that is not in the phantom: {volumes}"


def _of_compression(spec: SimulationSpec, report: Report) -> Iterator[str]:
    plate = spec.compression.elastic_plates
    if plate is not None and (least := report.get("least_plates_mm")):
        depth, width = max(least[0], plate.depth_mm), max(least[1], plate.width_mm)
        yield (
            f"the breast reaches beyond the plates that bend (depth_mm = {plate.depth_mm:g}, width_mm = "
            f"{plate.width_mm:g}), where they count as held; take compression.elastic_plates.depth_mm = {depth:g} and "
            f"width_mm = {width:g}"
        )


def _of_warp(report: Report) -> Iterator[str]:
    for tissue, counts in report.get("lesion_objects", {}).items():
        if counts["merged"]:
            yield f"{counts['merged']} objects of {tissue} touch another one after compression"
        if counts["lost"]:
            yield f"{counts['lost']} objects of {tissue} lay beside the breast and are missing after compression"
    if report.get("holes"):
        yield f"{report['holes']} voxels of the compressed breast are air with tissue on all six sides"


def _of_projections(spec: SimulationSpec, report: Report) -> Iterator[str]:
    if report.get("truncated"):
        yield "the compressed breast reaches beyond the detector or the beam (acquisition.truncation = 'allow')"
    least = report.get("min_pixel_value")
    if least is not None and least < FEWEST_STEPS:
        detector = spec.acquisition.detector
        largest = least * HIGHEST_OPEN_FIELD / detector.open_field_value
        remedy = one_of(
            where(largest >= FEWEST_STEPS, "a larger acquisition.detector.open_field_value"),
            "a larger physics.energy_keV",
        )
        error = "all of it" if least == 0 else f"{50 / least:.2g} %"
        yield f"the smallest pixel value is {least}, whose rounding is {error} of the signal; take {remedy}"


def _of_volume(spec: SimulationSpec, report: Report) -> Iterator[str]:
    slope, intercept = spec.reconstruction.value_slope, spec.reconstruction.value_intercept
    if number := report.get("clipped_high_voxels"):
        yield (
            f"{number} voxels of the volume are above {intercept + 65535 * slope:.3g} 1/mm and stored as that; take a "
            f"reconstruction.value_slope above {slope:g}"
        )
    if number := report.get("clipped_low_voxels"):
        yield (
            f"{number} voxels of the volume are below {intercept:g} 1/mm and stored as that; take a "
            f"reconstruction.value_intercept below {intercept:g}"
        )
