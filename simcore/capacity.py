"""Whether the objects of a case fit into DICOM, known from the specification, and what would fit.

The pixel data of one object is at most 4 GiB, in every encoding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from simcore.core.errors import GeometryError, ResourceLimitError, SpecError
from simcore.core.grid import Grid
from simcore.dicom.limits import MAX_BYTES, pixel_bytes
from simcore.projection.acquisition import geometry_of
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import SHADOW_MARGIN_MM, in_region, volume_grid, within
from simcore.reconstruction.spec import RegionSpec
from simcore.spec import SimulationSpec

Extent = tuple[float, float, float]
"""(depth along x, width along y, thickness along z) of the compressed breast, mm."""

Passes = Callable[[SimulationSpec], bool]

SHADOW_MARGIN = 1.03
"""The shadow's edge belongs to no single height of the breast; the prediction takes the middle and this much more."""

_STEP_MM = 0.01
"""Slice spacings are advised in steps of this."""
_LARGEST_SLICE_MM = 20.0


@dataclass(frozen=True)
class PixelData:
    """The largest element of an object. name: in words; field: of the specification, that decides its size."""

    name: str
    field: str
    value: float
    bytes: int

    @property
    def fits(self) -> bool:
        return self.bytes <= MAX_BYTES


def predicted_grid(spec: SimulationSpec, extent: Extent, whole: bool = False) -> Grid:
    """The voxels of the volume, detector frame; of the field ``breast`` at most so many.

    whole: over the field, whatever the region.
    raises: SpecError where the region holds no voxel.
    """
    setting, geometry = spec.reconstruction, geometry_of(spec.acquisition)
    beyond = beyond_plates(spec, extent)
    grid = volume_grid(geometry, setting, Body(_thickness(spec, extent), beyond, beyond))
    try:
        if setting.field == "breast":
            low, high = _breast_box(spec, grid, extent)
            grid = within(grid, low, high)
        if setting.region is not None and not whole:
            grid = in_region(grid, setting.region, geometry.support_height)
    except GeometryError as error:
        message = str(error)
        raise SpecError(
            f"reconstruction.region: {message}",
            code="geometry-not-possible",
            problems=[{"field": "reconstruction.region", "value": None, "message": message}],
        ) from error
    return grid


def _thickness(spec: SimulationSpec, extent: Extent) -> float:
    """Distance of the plates, mm: that of an uploaded phantom where it is known, else predicted."""
    known = spec.phantom.thickness_mm
    return extent[2] if known is None else known


def beyond_plates(spec: SimulationSpec, extent: Extent) -> float:
    """How far the breast reaches beyond either plate, mm, where its chest wall is held and the plates are not: by their
    way. Where the way is not known before, the least it can be."""
    if spec.phantom.compressed or spec.compression.chest_wall == "free_in_plane":
        return 0.0
    _, _, upper, lower = spec.phantom.semi_axes()
    return max(upper + lower - extent[2], 0.0) / 2


def _breast_box(spec: SimulationSpec, grid: Grid, extent: Extent) -> tuple[Any, Any]:
    """Corners (x, y, z), mm, of what all views see of the predicted breast; see reconstruction.grids.breast_grid."""
    depth, width, thickness = (SHADOW_MARGIN * extent[0], SHADOW_MARGIN * extent[1], extent[2])
    geometry = geometry_of(spec.acquisition)
    x, y, z = geometry.sources.T
    grown = z / (z - geometry.support_height - thickness / 2)
    shrink = grown * (1.0 - grid.centres("z")[:, None] / z)
    high_x = float(np.max(np.min(x + (depth - x) * shrink, axis=1)))
    high_y = float(np.max(np.min(y + (width / 2 - y) * shrink, axis=1)))
    low_y = float(np.min(np.max(y + (-width / 2 - y) * shrink, axis=1)))
    margin = SHADOW_MARGIN_MM
    return np.array([-np.inf, low_y - margin, -np.inf]), np.array([high_x + margin, high_y + margin, np.inf])


def objects(spec: SimulationSpec, extent: Extent) -> Iterator[PixelData]:
    """The objects that can become too large. raises: SpecError where the region holds no voxel."""
    a, encoding = spec.acquisition, spec.export.encoding
    d = a.detector
    size = pixel_bytes(a.views, d.pixels_y, d.pixels_x, 2, encoding)
    yield PixelData("the projections", "acquisition.views", a.views, size)
    shape = predicted_grid(spec, extent).shape
    slice_mm = spec.reconstruction.slice_mm
    yield PixelData("the volume", "reconstruction.slice_mm", slice_mm, pixel_bytes(*shape, 2, encoding))
    if "attenuation" in spec.export.extra_objects:
        # Floats, which are stored plain in every encoding.
        size = pixel_bytes(*shape, 4, "none")
        yield PixelData("the attenuation map", "reconstruction.slice_mm", slice_mm, size)


def check_objects(spec: SimulationSpec, extent: Extent, affordable: Passes) -> None:
    """Refuse objects that DICOM cannot hold, with what would fit.

    affordable: whether a specification passes every other limit; what is advised does.
    raises: ResourceLimitError
    """
    too_large = [data for data in objects(spec, extent) if not data.fits]
    if not too_large:
        return

    def passes(candidate: SimulationSpec) -> bool:
        return all(data.fits for data in objects(candidate, extent)) and affordable(candidate)

    base, problems = spec, []
    for field in dict.fromkeys(data.field for data in too_large):
        mine = [data for data in too_large if data.field == field]
        if field == "acquisition.views":
            base, remedy = _fewer_views(spec, mine[0])
        else:
            remedy = _smaller_volume(base, mine, extent, passes)
        sizes = " and ".join(f"{data.name} would hold {data.bytes / 1e9:.2f} GB" for data in mine)
        message = (
            f"{sizes} of pixels, and a DICOM object holds at most {MAX_BYTES / 1e9:.2f} GB in any encoding: {remedy}"
        )
        problems.append({"field": field, "value": mine[0].value, "message": message})
    text = "; ".join(f"{p['field']} = {p['value']:g}: {p['message']}" for p in problems)
    raise ResourceLimitError(text, problems=problems)


def _fewer_views(spec: SimulationSpec, data: PixelData) -> tuple[SimulationSpec, str]:
    """The specification with as many views as fit, and that in words."""
    a = spec.acquisition
    views = int(MAX_BYTES // (data.bytes / a.views))
    if a.trajectory is not None:
        fewer = a.model_dump(exclude={"views", "angular_range_degrees", "source_to_detector_mm"})
        fewer["trajectory"] = fewer["trajectory"][:views]
        return spec.with_(acquisition=type(a).model_validate(fewer)), f"at most {views} views"
    return spec.with_(acquisition=a.with_(views=views)), f"at most {views} views"


def _smaller_volume(spec: SimulationSpec, too_large: list[PixelData], extent: Extent, passes: Passes) -> str:
    """Changes of the reconstruction, or of what is written, with each of which alone the case passes."""
    remedies = []
    slice_mm = _thicker_slices(spec, passes)
    if slice_mm is not None:
        remedies.append(f"slice_mm = {slice_mm:g} or more")
    top = _lower_region(spec, extent, passes)
    if top is not None:
        remedies.append(f"reconstruction.region with z_max_mm = {top:g} or less")
    if spec.reconstruction.field == "detector":
        breast = spec.with_(reconstruction=spec.reconstruction.with_(field="breast"))
        if passes(breast):
            remedies.append("reconstruction.field = 'breast'")
    if any(data.name == "the attenuation map" for data in too_large):
        kept = [name for name in spec.export.extra_objects if name != "attenuation"]
        if passes(spec.with_(export=spec.export.with_(extra_objects=kept))):
            remedies.append("'attenuation' left out of export.extra_objects")
    return ", or ".join(remedies) or "use larger pixels (reconstruction.pixel_mm) as well as thicker slices"


def _thicker_slices(spec: SimulationSpec, passes: Passes) -> float | None:
    """The smallest slice spacing, in steps of 0.01 mm, with which the case passes; None without one."""

    def sliced(count: int) -> SimulationSpec:
        thicker = spec.reconstruction.with_(slice_mm=round(count * _STEP_MM, 2))
        return spec.with_(reconstruction=thicker)

    low = int(spec.reconstruction.slice_mm / _STEP_MM)
    count = _first(low, round(_LARGEST_SLICE_MM / _STEP_MM), lambda n: passes(sliced(n)))
    return None if count is None else round(count * _STEP_MM, 2)


def _lower_region(spec: SimulationSpec, extent: Extent, passes: Passes) -> float | None:
    """The highest upper bound of the region, mm above the support, with which the case passes; None without one."""
    setting = spec.reconstruction
    region = setting.region or RegionSpec()
    grid = predicted_grid(spec, extent)
    bottom = grid.corner[2] - geometry_of(spec.acquisition).support_height

    def top(slices: int) -> float:
        # Downwards, so that the bound touches no further slice.
        return float(np.floor((bottom + slices * setting.slice_mm) * 100 + 1e-6) / 100)

    def cut_passes(slices: int) -> bool:
        if top(slices) <= (region.z_min_mm or 0.0):
            return False
        return passes(spec.with_(reconstruction=setting.with_(region=region.with_(z_max_mm=top(slices)))))

    fewer = _first(1, grid.shape[0] - 1, lambda n: cut_passes(grid.shape[0] - n))
    return None if fewer is None else top(grid.shape[0] - fewer)


def _first(low: int, high: int, holds: Callable[[int], bool]) -> int | None:
    """The smallest number of low..high for which ``holds``, which holds for all that are larger; None without one."""
    if low > high or not holds(high):
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle + 1, high)
    return low
