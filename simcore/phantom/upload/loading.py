"""An uploaded label volume as a phantom: its values as tissues, its axes as ours, cut to its tissue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import IO

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Compression, Phantom, Report
from simcore.core.errors import SpecError
from simcore.core.grid import Grid
from simcore.core.progress import Progress, silent
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.phantom.upload import tissue_maps
from simcore.phantom.upload.decoding import planes, read_header
from simcore.phantom.upload.header import Header
from simcore.phantom.upload.spec import Axes, UploadedPhantom

LEAST_WALL = 0.2
"""Least area of the tissue at the chest wall relative to that of the largest plane across x."""
MARGIN = 1
"""Voxels of air around a phantom that is to be meshed."""
DENSE = (Tissue.GLAND, Tissue.DUCT, Tissue.TDLU)

Box = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
"""(first, behind the last) voxel along z, y and x."""


@dataclass(frozen=True)
class Survey:
    """What a file holds, found without keeping its voxels.

    values: voxels of every value.
    extent: planes from the first to the last that are not all air, along the axes of the array; 0 where all is air.
    """

    header: Header
    values: dict[int, int]
    extent: tuple[int, int, int]

    def extent_mm(self, spacing_mm: tuple[float, float, float], axes: Axes) -> tuple[float, float, float] | None:
        """Size of what is not air along (x, y, z), mm; None where there is nothing."""
        if not all(self.extent):
            return None
        along = {axis[1]: round(n * edge, 6) for axis, n, edge in zip(axes, self.extent, spacing_mm, strict=True)}
        return along["x"], along["y"], along["z"]


def survey(file: IO[bytes], tissues: tissue_maps.TissueMap) -> Survey:
    """Reads a whole file and counts its values.

    raises: SpecError where it cannot be read, or holds a value without a tissue.
    """
    header = read_header(file)
    table = tissue_maps.table(tissues)
    counts = np.zeros(tissue_maps.LARGEST_VALUE + 1, np.int64)
    filled = [np.zeros(n, np.bool_) for n in header.shape]
    for first, voxels in planes(file, header):
        values = _in_range(voxels)
        counts += np.bincount(values.ravel(), minlength=len(counts))
        body = table[values] != Tissue.AIR
        filled[0][first : first + len(body)] = body.any(axis=(1, 2))
        filled[1] |= body.any(axis=(0, 2))
        filled[2] |= body.any(axis=(0, 1))
    present = np.flatnonzero(counts)
    unknown = present[table[present] == tissue_maps.UNKNOWN]
    if len(unknown):
        tissue_maps.refuse_unknown(int(v) for v in unknown)
    a, b, c = (int(np.ptp(np.flatnonzero(f)) + 1) if f.any() else 0 for f in filled)
    return Survey(header, {int(v): int(counts[v]) for v in present}, (a, b, c))


def load(spec: UploadedPhantom, file: IO[bytes], progress: Progress = silent) -> Phantom:
    """The phantom in a file: in the breast frame, z = 0 in the middle; a compressed one in the support frame.

    raises: SpecError where the file is not what ``spec`` says, holds unknown values or no breast.
    """
    header = read_header(file)
    if header.shape != spec.shape:
        raise _wrong("shape", list(spec.shape), f"the file has {list(header.shape)} voxels")
    native = np.empty(header.shape, np.uint8)
    table = tissue_maps.table(spec.tissues)
    for first, voxels in planes(file, header):
        part = native[first : first + len(voxels)]
        values = _in_range(voxels)
        np.take(table, values, out=part)
        if part.max(initial=0) >= MAX_TISSUES:
            tissue_maps.refuse_unknown(int(v) for v in np.unique(values[part == tissue_maps.UNKNOWN]))
        progress(0.7 * (first + len(voxels)) / header.shape[0], "reading voxels")
    labels, spacing = _oriented(native, spec)
    box = _tissue_box(labels)
    if box is None:
        raise _wrong("tissues", None, "the label volume holds nothing but air")
    _check_wall(labels, box, spec)
    progress(0.8, "cutting to the tissue")
    if spec.compressed:
        cut, grid = _compressed(labels, box, spacing, spec.thickness_mm)
    else:
        cut, grid = _uncompressed(labels, box, spacing)
    report = _report(cut, grid, spec)
    progress(1.0, "phantom ready")
    return Phantom(cut, grid, (), report)


def plates(spec: UploadedPhantom, phantom: Phantom) -> Compression:
    """See simcore.phantom.plates."""
    height = phantom.grid.upper[2]
    thickness = height if spec.thickness_mm is None else spec.thickness_mm
    report: Report = {"thickness_mm": thickness, "uploaded": True}
    if spec.force_N is not None:
        report["force_N"] = spec.force_N
    return Compression(np.zeros((0, 3)), (0.0, thickness), spec.force_N, "converged", report)


def _in_range(voxels: NDArray[np.integer]) -> NDArray[np.integer]:
    """The voxels, of a type that indexes. raises: SpecError for values that no tissue map can name"""
    if voxels.dtype.itemsize > 2 or voxels.dtype.kind == "i":
        low, high = int(voxels.min(initial=0)), int(voxels.max(initial=0))
        if low < 0 or high > tissue_maps.LARGEST_VALUE:
            tissue_maps.refuse_unknown({v for v in (low, high) if not 0 <= v <= tissue_maps.LARGEST_VALUE})
    return voxels.astype(np.uint16, copy=False) if voxels.dtype.itemsize > 1 else voxels.astype(np.uint8, copy=False)


def _oriented(native: NDArray[np.uint8], spec: UploadedPhantom) -> tuple[NDArray[np.uint8], tuple[float, float, float]]:
    """A view (z, y, x) whose axes lead where ours do, and its voxel edges along (x, y, z)."""
    order = [next(n for n, axis in enumerate(spec.axes) if axis[1] == name) for name in "zyx"]
    view = native.transpose(order)
    view = view[tuple(slice(None, None, 1 if spec.axes[n][0] == "+" else -1) for n in order)]
    z, y, x = (spec.spacing_mm[n] for n in order)
    return view, (x, y, z)


def _tissue_box(labels: NDArray[np.uint8]) -> Box | None:
    """Bounds of what is not air."""
    bounds = []
    for axis in range(3):
        others = tuple(a for a in range(3) if a != axis)
        found = np.flatnonzero(labels.any(axis=others))
        if not len(found):
            return None
        bounds.append((int(found[0]), int(found[-1]) + 1))
    z, y, x = bounds
    return z, y, x


def _check_wall(labels: NDArray[np.uint8], box: Box, spec: UploadedPhantom) -> None:
    """raises: SpecError where x does not lead from a flat chest wall to the nipple"""
    (z0, z1), (y0, y1), (x0, x1) = box
    area = np.count_nonzero(labels[z0:z1, y0:y1, x0:x1], axis=(0, 1))
    if area[0] < LEAST_WALL * area.max() or area[0] < area[-1]:
        raise _wrong(
            "axes",
            list(spec.axes),
            f"the tissue covers {area[0]} voxels of the first plane across x, {area.max()} of the largest and "
            f"{area[-1]} of the last: the first must be a flat chest wall, the last the nipple; turn an axis "
            "(+x or -x), or cut the volume where the breast begins",
        )


def _uncompressed(
    labels: NDArray[np.uint8], box: Box, spacing: tuple[float, float, float]
) -> tuple[NDArray[np.uint8], Grid]:
    """Cut to the tissue with air on all sides but the chest wall; y = 0 and z = 0 in the middle."""
    (z0, z1), (y0, y1), (x0, x1) = box
    cut = np.zeros((z1 - z0 + 2 * MARGIN, y1 - y0 + 2 * MARGIN, x1 - x0 + MARGIN), np.uint8)
    cut[MARGIN:-MARGIN, MARGIN:-MARGIN, :-MARGIN] = labels[z0:z1, y0:y1, x0:x1]
    nz, ny, _ = cut.shape
    return cut, Grid(cut.shape, spacing, (0.0, -ny * spacing[1] / 2, -nz * spacing[2] / 2))


def _compressed(
    labels: NDArray[np.uint8], box: Box, spacing: tuple[float, float, float], thickness: float | None
) -> tuple[NDArray[np.uint8], Grid]:
    """Cut to the tissue, which stands on z = 0; y = 0 in the middle. raises: SpecError where it is above the plate"""
    (z0, z1), (y0, y1), (x0, x1) = box
    height = (z1 - z0) * spacing[2]
    if thickness is not None and thickness < height - spacing[2]:
        raise _wrong("thickness_mm", thickness, f"the tissue is {height:g} mm high; at least that, or none")
    cut = np.ascontiguousarray(labels[z0:z1, y0:y1, x0:x1])
    return cut, Grid(cut.shape, spacing, (0.0, -(y1 - y0) * spacing[1] / 2, 0.0))


def _report(labels: NDArray[np.uint8], grid: Grid, spec: UploadedPhantom) -> Report:
    counts = np.zeros(MAX_TISSUES, np.int64)
    for plane in labels:
        counts += np.bincount(plane.ravel(), minlength=MAX_TISSUES)
    voxel_ml = grid.voxel_volume * 1e-3
    inner = int(counts.sum() - counts[Tissue.AIR] - counts[Tissue.SKIN] - counts[Tissue.NIPPLE])
    report: Report = {
        "volume_ml": int(counts[1:].sum()) * voxel_ml,
        "glandularity": int(counts[list(DENSE)].sum()) / max(1, inner),
        "glandularity_definition": "gland, duct and lobule voxels / (all voxels but air, skin and nipple)",
        "tissue_ml": {t.name.lower(): float(counts[t]) * voxel_ml for t in Tissue if t and counts[t]},
        "voxels": grid.size,
        "upload": spec.sha256,
        "compressed": spec.compressed,
    }
    return report


def _wrong(field: str, value: object, message: str) -> SpecError:
    problem = {"field": f"phantom.{field}", "value": value, "message": message}
    return SpecError(
        f"phantom.{field}{'' if value is None else f' = {value}'}: {message}",
        code="upload-mismatch",
        problems=[problem],
    )
