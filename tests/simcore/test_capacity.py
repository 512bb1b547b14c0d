"""What DICOM cannot hold is refused before anything runs, and what is advised instead passes."""

from __future__ import annotations

import re

import numpy as np
import pytest

from simcore import estimate, presets
from simcore.capacity import predicted_grid
from simcore.core.artifacts import ProjectionStack
from simcore.core.errors import ResourceLimitError, SpecError
from simcore.dicom.limits import MAX_BYTES, pixel_bytes
from simcore.dicom.run_length import run_length_frame
from simcore.projection.acquisition import geometry_of
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import volume_grid
from simcore.reconstruction.grids import breast_grid
from simcore.spec import SimulationSpec

MEMORY = 256 << 30
ENCODINGS = ("none", "jpeg-ls", "rle")


def changed(base: str = "paper-cup-c-20", **parts: dict[str, object]) -> SimulationSpec:
    data = presets.get(base).model_dump()
    for name, values in parts.items():
        data[name].update(values)
    return SimulationSpec.from_dict(data)


def refusal(spec: SimulationSpec) -> ResourceLimitError:
    with pytest.raises(ResourceLimitError) as caught:
        estimate.check(spec, MEMORY)
    return caught.value


def number(pattern: str, text: str) -> float:
    match = re.search(pattern, text)
    assert match, text
    return float(match[1])


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("extras", [[], ["attenuation"]])
def test_the_volume(encoding: str, extras: list[str]) -> None:
    """Cup C at 0.1 mm slices: 8.5 GB and more were told to be fine."""
    export = {"encoding": encoding, "extra_objects": extras}
    spec = changed(reconstruction={"slice_mm": 0.1}, export=export)
    error = refusal(spec)
    assert error.problems[0]["field"] == "reconstruction.slice_mm"
    assert error.problems[0]["value"] == 0.1
    text = str(error)
    assert number(r"the volume would hold (\S+) GB", text) > 8
    assert ("attenuation map" in text) == bool(extras)
    slice_mm = number(r"slice_mm = (\S+) or more", text)
    top = number(r"z_max_mm = (\S+) or less", text)
    estimate.check(changed(reconstruction={"slice_mm": slice_mm}, export=export), MEMORY)
    estimate.check(changed(reconstruction={"slice_mm": 0.1, "region": {"z_max_mm": top}}, export=export), MEMORY)
    # No more than is needed.
    refusal(changed(reconstruction={"slice_mm": round(slice_mm - 0.01, 2)}, export=export))
    refusal(changed(reconstruction={"slice_mm": 0.1, "region": {"z_max_mm": top + 0.1}}, export=export))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_attenuation_map_alone(encoding: str) -> None:
    export = {"encoding": encoding, "extra_objects": ["attenuation", "report"]}
    reconstruction = {"slice_mm": 0.3}
    text = str(refusal(changed(reconstruction=reconstruction, export=export)))
    assert "the volume would" not in text
    assert "'attenuation' left out of export.extra_objects" in text
    estimate.check(changed(reconstruction=reconstruction, export={**export, "extra_objects": ["report"]}), MEMORY)


def test_the_field_of_the_breast_where_it_is_enough() -> None:
    spec = changed("paper-cup-c-50", reconstruction={"slice_mm": 0.1})
    assert "reconstruction.field = 'breast'" in str(refusal(spec))
    estimate.check(changed("paper-cup-c-50", reconstruction={"slice_mm": 0.1, "field": "breast"}), MEMORY)
    # Of the large breast it is not, and not advised.
    assert "'breast'" not in str(refusal(changed(reconstruction={"slice_mm": 0.1, "pixel_mm": 0.05})))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_projections(encoding: str) -> None:
    detector = {"pixels_x": 8192, "pixels_y": 8192, "pixel_mm": 0.04}
    parts = {
        "acquisition": {"views": 60, "detector": detector, "truncation": "allow"},
        "export": {"encoding": encoding},
        "reconstruction": {"pixel_mm": 0.1},
    }
    error = refusal(changed(**parts))
    assert [p["field"] for p in error.problems] == ["acquisition.views"]
    views = int(number(r"at most (\d+) views", str(error)))
    parts["acquisition"]["views"] = views
    estimate.check(changed(**parts), MEMORY)
    parts["acquisition"]["views"] = views + 1
    refusal(changed(**parts))


def test_both_at_once_are_told_at_once() -> None:
    detector = {"pixels_x": 8192, "pixels_y": 8192, "pixel_mm": 0.04}
    parts = {"acquisition": {"views": 60, "detector": detector, "truncation": "allow"}}
    error = refusal(changed(**parts))
    assert [p["field"] for p in error.problems] == ["acquisition.views", "reconstruction.slice_mm"]
    parts["acquisition"]["views"] = int(number(r"at most (\d+) views", str(error)))
    slice_mm = number(r"slice_mm = (\S+) or more", str(error))
    estimate.check(changed(**parts, reconstruction={"slice_mm": slice_mm}), MEMORY)


def test_advice_is_within_the_memory_too() -> None:
    """5 GB hold no volume of 4 GB beside the rest: the advice is what passes both limits."""
    limit = 5 << 30
    spec = changed(reconstruction={"slice_mm": 0.1})
    with pytest.raises(ResourceLimitError) as caught:
        estimate.check(spec, limit)
    slice_mm = number(r"slice_mm = (\S+) or more", str(caught.value))
    assert slice_mm > number(r"slice_mm = (\S+) or more", str(refusal(spec)))
    estimate.check(changed(reconstruction={"slice_mm": slice_mm}), limit)


def test_a_region_without_a_voxel_is_refused() -> None:
    with pytest.raises(SpecError, match=r"reconstruction\.region: the region from 300 to inf mm along x holds no"):
        estimate.check(changed(reconstruction={"region": {"x_min_mm": 300.0}}), MEMORY)


def test_a_region_costs_what_it_holds() -> None:
    whole = estimate.check(changed(), MEMORY)
    part = estimate.check(changed(reconstruction={"region": {"z_min_mm": 10.0, "z_max_mm": 20.0}}), MEMORY)
    assert whole.output_bytes - part.output_bytes > 80 * 2304 * 1920 * 2
    # Every voxel is iterated over, whatever is kept.
    sart = {"kind": "sart", "slice_mm": 1.0, "pixel_mm": None, "field": "detector", "region": None}
    spec = presets.get("paper-cup-c-20").model_dump()
    spec["reconstruction"] = sart
    all_of_it = estimate.estimate(SimulationSpec.from_dict(spec))
    spec["reconstruction"] = {**sart, "region": {"z_min_mm": 10.0, "z_max_mm": 20.0}}
    assert estimate.estimate(SimulationSpec.from_dict(spec)).memory_bytes == all_of_it.memory_bytes


def test_run_lengths_grow_by_no_more_than_predicted() -> None:
    """The worst there is: no byte like its neighbour."""
    for columns in (1, 127, 128, 129, 1920):
        frame = np.random.default_rng(1).permutation(5 * columns).astype(np.uint16).reshape(5, columns)
        frame = (frame * 257) ^ 0x55AA
        assert len(run_length_frame(frame)) + 8 <= pixel_bytes(1, 5, columns, 2, "rle")
    assert pixel_bytes(2, 3, 4, 2, "jpeg-ls") == pixel_bytes(2, 3, 4, 2, "none") == 48
    assert MAX_BYTES == 2**32 - 2


def test_the_field_of_the_breast_is_not_predicted_too_small() -> None:
    """An ellipsoid between the plates, its shadow cast ray by ray."""
    spec = changed(
        "paper-cup-c-50",
        acquisition={"detector": {"pixels_x": 96, "pixels_y": 116, "pixel_mm": 2.0}},
        reconstruction={"field": "breast", "slice_mm": 2.0},
    )
    depth, width, thickness = extent = estimate.compressed_extent(spec)
    geometry = geometry_of(spec.acquisition)
    low = geometry.support_height
    levels = low + (np.arange(40) + 0.5) / 40 * thickness
    frames = np.full((geometry.views, 116, 96), 10000, np.uint16)
    columns = (np.arange(96) + 0.5) * 2.0
    rows = (np.arange(116) - 57.5) * 2.0
    for view, (sx, sy, sz) in enumerate(geometry.sources):
        for z in levels:
            x = sx + (columns - sx) * (1 - z / sz)
            y = sy + (rows - sy) * (1 - z / sz)
            radius = 1 - (2 * (z - low) / thickness - 1) ** 2
            frames[view][(x / depth) ** 2 + (y[:, None] / (width / 2)) ** 2 < radius] = 1000
    stack = ProjectionStack(frames, 10000.0, geometry)
    actual = breast_grid(stack, volume_grid(geometry, spec.reconstruction, Body(thickness)))
    predicted = predicted_grid(spec, extent)
    assert all(p >= a for p, a in zip(predicted.shape, actual.shape, strict=True))
    assert predicted.size < 1.25 * actual.size
