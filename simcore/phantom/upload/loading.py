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
from simcore.phantom.upload.decoding import blocks, read_header
from simcore.phantom.upload.header import Edges, Header
from simcore.phantom.upload.spec import Axes, UploadedPhantom
from simcore.phantom.upload.values import labels_of

LEAST_WALL = 0.2
"""Least area of the tissue at the chest wall relative to that of the largest plane across x."""
MARGIN = 1
"""Voxels of air around a phantom that is to be meshed."""
DENSE = (Tissue.GLAND, Tissue.DUCT, Tissue.TDLU)

Box = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
"""(first, behind the last) voxel along the axes of an array."""


@dataclass(frozen=True)
class Survey:
    """What a file holds, found without keeping its voxels.

    values: voxels of every value.
    areas:  voxels that are not air in every plane across each axis of the array; three arrays, slowest axis first.
    """

    header: Header
    values: dict[int, int]
    areas: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]

    @property
    def box(self) -> Box | None:
        """(first, behind the last) plane that is not all air, along each axis of the array; None where all is air."""
        filled = [np.flatnonzero(area) for area in self.areas]
        if not len(filled[0]):
            return None
        a, b, c = ((int(f[0]), int(f[-1]) + 1) for f in filled)
        return a, b, c

    @property
    def body_voxels(self) -> int:
        """Voxels that are not air."""
        return int(self.areas[0].sum())

    def extent_mm(self, spacing_mm: Edges, axes: Axes) -> tuple[float, float, float] | None:
        """Size of what is not air along (x, y, z), mm; None where there is nothing."""
        if self.box is None:
            return None
        planes = (last - first for first, last in self.box)
        along = {axis[1]: round(n * edge, 6) for axis, n, edge in zip(axes, planes, spacing_mm, strict=True)}
        return along["x"], along["y"], along["z"]


def survey(file: IO[bytes], tissues: tissue_maps.TissueMap, progress: Progress = silent) -> Survey:
    """Reads a whole file and counts its values.

    raises: SpecError where it cannot be read, or holds a value without a tissue.
    """
    header = read_header(file)
    table = tissue_maps.table(tissues)
    counts = np.zeros(tissue_maps.LARGEST_VALUE + 1, np.int64)
    areas = tuple(np.zeros(n, np.int64) for n in header.shape)
    for plane, row, voxels in blocks(file, header):
        n, rows, _ = voxels.shape
        labels = labels_of(voxels, header)
        if not labels.any() and table[0] == Tissue.AIR:  # most of a large volume
            counts[0] += labels.size
        else:
            part = np.bincount(labels.ravel())
            counts[: len(part)] += part
            body = table[labels] != Tissue.AIR
            areas[0][plane : plane + n] += np.count_nonzero(body, axis=(1, 2))
            areas[1][row : row + rows] += np.count_nonzero(body, axis=(0, 2))
            areas[2][:] += np.count_nonzero(body, axis=(0, 1))
        progress((plane + n) / header.shape[0], "looking for the tissue")
    present = np.flatnonzero(counts)
    unknown = present[table[present] == tissue_maps.UNKNOWN]
    if len(unknown):
        tissue_maps.refuse_unknown(int(v) for v in unknown)
    return Survey(header, {int(v): int(counts[v]) for v in present}, areas)  # type: ignore[arg-type]


def load(spec: UploadedPhantom, file: IO[bytes], progress: Progress = silent) -> Phantom:
    """The phantom in a file: in the breast frame, z = 0 in the middle; a compressed one in the support frame.

    It is read twice, block by block: only what is cut out of it is ever held.

    raises: SpecError where the file is not what ``spec`` says, holds unknown values or no breast.
    """
    header = read_header(file)
    if header.shape != spec.shape:
        raise _wrong("shape", list(spec.shape), f"the file has {list(header.shape)} voxels")
    found = survey(file, spec.tissues, lambda fraction, message: progress(0.45 * fraction, message))
    if found.box is None:
        raise _wrong("tissues", None, "the label volume holds nothing but air")
    _check_wall(found, spec)
    labels, grid = _compressed(found.box, spec) if spec.compressed else _uncompressed(found.box, spec)
    margin = 0 if spec.compressed else MARGIN
    inner = labels[margin : len(labels) - margin, margin : labels.shape[1] - margin, : labels.shape[2] - margin]
    _fill(_native(inner, spec.axes), file, found, spec, progress)
    report = _report(labels, grid, spec)
    progress(1.0, "phantom ready")
    return Phantom(labels, grid, (), report)


def _fill(target: NDArray[np.uint8], file: IO[bytes], found: Survey, spec: UploadedPhantom, progress: Progress) -> None:
    """Writes the tissues of the voxels in ``found.box`` to ``target``, whose axes are those of the array."""
    header, table = found.header, tissue_maps.table(spec.tissues)
    (a0, a1), (b0, b1), (c0, c1) = found.box  # type: ignore[misc]
    for plane, row, voxels in blocks(file, header):
        n, rows, _ = voxels.shape
        planes = slice(max(plane, a0), min(plane + n, a1))
        lines = slice(max(row, b0), min(row + rows, b1))
        if planes.start < planes.stop and lines.start < lines.stop:
            part = voxels[planes.start - plane : planes.stop - plane, lines.start - row : lines.stop - row, c0:c1]
            target[planes.start - a0 : planes.stop - a0, lines.start - b0 : lines.stop - b0] = table[
                labels_of(part, header)
            ]
        progress(0.45 + 0.5 * (plane + n) / header.shape[0], "reading voxels")


def plates(spec: UploadedPhantom, phantom: Phantom) -> Compression:
    """See simcore.phantom.plates."""
    height = phantom.grid.upper[2]
    thickness = height if spec.thickness_mm is None else spec.thickness_mm
    report: Report = {"thickness_mm": thickness, "uploaded": True}
    if spec.force_N is not None:
        report["force_N"] = spec.force_N
    return Compression(np.zeros((0, 3)), (0.0, thickness), spec.force_N, "converged", report)


def _native(labels: NDArray[np.uint8], axes: Axes) -> NDArray[np.uint8]:
    """A view of an array (z, y, x) along the axes of a file that lead where ``axes`` say."""
    view = labels.transpose(["zyx".index(axis[1]) for axis in axes])
    return view[tuple(slice(None, None, 1 if axis[0] == "+" else -1) for axis in axes)]


def _along(spec: UploadedPhantom, name: str) -> int:
    """Which axis of the array leads along "x", "y" or "z"."""
    return next(n for n, axis in enumerate(spec.axes) if axis[1] == name)


def _check_wall(found: Survey, spec: UploadedPhantom) -> None:
    """raises: SpecError where x does not lead from a flat chest wall to the nipple"""
    n = _along(spec, "x")
    first, last = found.box[n]  # type: ignore[index]
    area = found.areas[n][first:last][:: 1 if spec.axes[n][0] == "+" else -1]
    if area[0] < LEAST_WALL * area.max() or area[0] < area[-1]:
        raise _wrong(
            "axes",
            list(spec.axes),
            f"the tissue covers {area[0]} voxels of the first plane across x, {area.max()} of the largest and "
            f"{area[-1]} of the last: the first must be a flat chest wall, the last the nipple; turn an axis "
            "(+x or -x), or cut the volume where the breast begins",
        )


def _cut_size(box: Box, spec: UploadedPhantom) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
    """Voxels (nz, ny, nx) of a box along the axes of the array, and voxel edges along (x, y, z)."""
    nz, ny, nx = (box[_along(spec, name)][1] - box[_along(spec, name)][0] for name in "zyx")
    x, y, z = (spec.spacing_mm[_along(spec, name)] for name in "xyz")
    return (nz, ny, nx), (x, y, z)


def _uncompressed(box: Box, spec: UploadedPhantom) -> tuple[NDArray[np.uint8], Grid]:
    """Room for the tissue with air on all sides but the chest wall; y = 0 and z = 0 in the middle."""
    (nz, ny, nx), spacing = _cut_size(box, spec)
    shape = (nz + 2 * MARGIN, ny + 2 * MARGIN, nx + MARGIN)
    return np.zeros(shape, np.uint8), Grid(
        shape, spacing, (0.0, -shape[1] * spacing[1] / 2, -shape[0] * spacing[2] / 2)
    )


def _compressed(box: Box, spec: UploadedPhantom) -> tuple[NDArray[np.uint8], Grid]:
    """Room for the tissue, which stands on z = 0; y = 0 in the middle. raises: SpecError where it is above the plate"""
    shape, spacing = _cut_size(box, spec)
    height = shape[0] * spacing[2]
    if spec.thickness_mm is not None and spec.thickness_mm < height - spacing[2]:
        raise _wrong("thickness_mm", spec.thickness_mm, f"the tissue is {height:g} mm high; at least that, or none")
    return np.zeros(shape, np.uint8), Grid(shape, spacing, (0.0, -shape[1] * spacing[1] / 2, 0.0))


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
