"""An uploaded label volume as a phantom: its values as tissues, its axes as ours, cut to its tissue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import IO

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Compression, Phantom, Report
from simcore.core.grid import Grid
from simcore.core.progress import Progress, silent
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.phantom.upload import lesions, paddle, pieces, tissue_maps, wall
from simcore.phantom.upload.anatomy import Anatomy
from simcore.phantom.upload.formats.decoding import blocks, read_header
from simcore.phantom.upload.formats.header import Header
from simcore.phantom.upload.paddle import refused
from simcore.phantom.upload.pieces import Box
from simcore.phantom.upload.spec import Axes, UploadedPhantom, along
from simcore.phantom.upload.values import labels_of

MARGIN = 1
"""Voxels of air around a phantom that is to be meshed."""
DENSE = (Tissue.GLAND, Tissue.DUCT, Tissue.TDLU)

Areas = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True)
class Survey:
    """What a file holds, read without keeping its voxels.

    values: voxels of every value.
    areas:  voxels of tissue in every plane across each axis of the array; three arrays, slowest axis first.
    plates: those of compression plates.
    """

    header: Header
    values: dict[int, int]
    areas: Areas
    plates: Areas

    @property
    def box(self) -> Box | None:
        """(first, behind the last) plane with tissue, along each axis of the array; None where there is none."""
        filled = [np.flatnonzero(area) for area in self.areas]
        if not len(filled[0]):
            return None
        a, b, c = ((int(f[0]), int(f[-1]) + 1) for f in filled)
        return a, b, c

    @property
    def body_voxels(self) -> int:
        """Voxels of tissue."""
        return int(self.areas[0].sum())

    def ends(self, box: Box) -> tuple[wall.Ends, wall.Ends, wall.Ends]:
        """Of the planes of a box."""
        a, b, c = (wall.Ends.of(area[first:behind]) for area, (first, behind) in zip(self.areas, box, strict=True))
        return a, b, c


def survey(
    file: IO[bytes], tissues: tissue_maps.TissueMap, progress: Progress = silent, anatomy: Anatomy | None = None
) -> Survey:
    """Reads a whole file and counts its values. anatomy: is shown all of it.

    raises: SpecError where it cannot be read, or holds a value without a tissue.
    """
    header = read_header(file)
    table = tissue_maps.table(tissues)
    counts = np.zeros(tissue_maps.LARGEST_VALUE + 1, np.int64)
    areas, plates_areas = (tuple(np.zeros(n, np.int64) for n in header.shape) for _ in range(2))
    for plane, row, voxels in blocks(file, header):
        n, rows, _ = voxels.shape
        labels = labels_of(voxels, header)
        if not labels.any() and table[0] == Tissue.AIR:  # most of a large volume
            counts[0] += labels.size
            if anatomy is not None:
                anatomy.skip(row, n, rows)
        else:
            part = np.bincount(labels.ravel())
            counts[: len(part)] += part
            codes = table[labels]
            _count(codes == tissue_maps.PADDLE, plates_areas, plane, row)
            _count((codes != Tissue.AIR) & (codes != tissue_maps.PADDLE), areas, plane, row)
            if anatomy is not None:
                anatomy.add(row, codes)
        progress((plane + n) / header.shape[0], "looking for the tissue")
    present = np.flatnonzero(counts)
    unknown = present[table[present] == tissue_maps.UNKNOWN]
    if len(unknown):
        tissue_maps.refuse_unknown(int(v) for v in unknown)
    values = {int(v): int(counts[v]) for v in present}
    return Survey(header, values, areas, plates_areas)  # type: ignore[arg-type]


def _count(mask: NDArray[np.bool_], areas: tuple[NDArray[np.int64], ...], plane: int, row: int) -> None:
    """Adds the voxels of a block of a mask to those of its planes."""
    if mask.any():
        n, rows, _ = mask.shape
        areas[0][plane : plane + n] += np.count_nonzero(mask, axis=(1, 2))
        areas[1][row : row + rows] += np.count_nonzero(mask, axis=(0, 2))
        areas[2][:] += np.count_nonzero(mask, axis=(0, 1))


def cut_box(scan: Survey, axes: Axes, compressed: bool, body: Box | None = None) -> tuple[Box, paddle.Gap | None]:
    """What is cut out of the array: the tissue, of a compressed breast that between its plates, and these.

    body: of the tissue where not all of it counts.
    raises: SpecError where there is no tissue, or plates that do not fit
    """
    box = body or scan.box
    if box is None:
        raise refused("tissues", None, "the label volume holds nothing but air")
    gap = paddle.gap(scan.plates, scan.areas, axes)
    if gap is None:
        return box, None
    if not compressed:
        raise paddle.not_compressed()
    a, b, c = ((gap.first, gap.behind) if axis[1] == "z" else side for axis, side in zip(axes, box, strict=True))
    return (a, b, c), gap


def load(spec: UploadedPhantom, file: IO[bytes], progress: Progress = silent) -> Phantom:
    """The phantom in a file: in the breast frame, z = 0 in the middle; a compressed one in the support frame.

    It is read twice, block by block: only what is cut out of it is ever held.

    raises: SpecError where the file is not what ``spec`` says, holds unknown values or no breast.
    """
    header = read_header(file)
    if header.shape != spec.shape:
        raise refused("shape", list(spec.shape), f"the file has {list(header.shape)} voxels")
    anatomy = None if spec.compressed else Anatomy(header.shape, body_only=True)
    scan = survey(file, spec.tissues, lambda fraction, message: progress(0.45 * fraction, message), anatomy)
    extents = anatomy.body.extents() if anatomy else None
    body = pieces.body_box(extents, spec.voxel_volume_mm3) if extents else None
    box, gap = cut_box(scan, spec.axes, spec.compressed, body)
    _check_extent(box, spec)
    wall.check(scan.ends(box), spec.axes)
    labels, margin = _room(box, spec)
    inner = labels[margin : len(labels) - margin, margin : labels.shape[1] - margin, : labels.shape[2] - margin]
    _fill(_native(inner, spec.axes), file, scan, box, spec, progress)
    dropped = 0
    if gap is not None:
        inner[inner == tissue_maps.PADDLE] = Tissue.AIR
    elif body is not None and extents is not None:
        pieces.drop(inner)
        dropped = len(extents) - 1
    kept = inner[_filled(inner, all_z=gap is not None)]
    wall.check_kept(np.count_nonzero(kept, axis=(0, 1)), spec.axes)
    if kept.shape != inner.shape:
        labels = np.pad(kept, ((margin, margin), (margin, margin), (0, margin)))
    grid = _compressed_grid(labels, spec, gap) if spec.compressed else _uncompressed_grid(labels, spec)
    counts = _census(labels)
    report = _report(counts, grid, spec)
    if gap is not None:
        report["plates_mm"] = grid.upper[2]
    if dropped:
        report["dropped_pieces"] = dropped
    report |= _left_out(counts, scan, spec)
    truth = lesions.truth(labels, grid)
    progress(1.0, "phantom ready")
    return Phantom(labels, grid, truth, report)


def _check_extent(box: Box, spec: UploadedPhantom) -> None:
    """raises: SpecError where there is more tissue than the specification says, by which its needs are predicted"""
    if spec.extent_mm is None:
        return
    sides, edges = [box[along(spec.axes, name)] for name in "xyz"], _spacing(spec)
    size = [round((last - first) * edge, 6) for (first, last), edge in zip(sides, edges, strict=True)]
    if any(real > said + 0.5 * edge for real, said, edge in zip(size, spec.extent_mm, edges, strict=True)):
        shown = " x ".join(f"{s:g}" for s in size)
        raise refused("extent_mm", list(spec.extent_mm), f"the tissue is {shown} mm; that, or none (null)")


def _fill(
    target: NDArray[np.uint8], file: IO[bytes], scan: Survey, box: Box, spec: UploadedPhantom, progress: Progress
) -> None:
    """Writes the tissues of the voxels in ``box`` to ``target``, whose axes are those of the array."""
    header, table = scan.header, tissue_maps.table(spec.tissues)
    (a0, a1), (b0, b1), (c0, c1) = box
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


def _filled(labels: NDArray[np.uint8], all_z: bool) -> tuple[slice, ...]:
    """The planes with tissue across (z, y, x). all_z: all of those across z."""
    sides = []
    for axis in range(3):
        planes = np.flatnonzero(labels.any(axis=tuple(a for a in range(3) if a != axis)))
        if not len(planes):
            raise refused("tissues", None, "no tissue is left")
        sides.append(slice(None) if all_z and axis == 0 else slice(int(planes[0]), int(planes[-1]) + 1))
    return tuple(sides)


def plates(spec: UploadedPhantom, phantom: Phantom) -> Compression:
    """See simcore.phantom.plates."""
    height = phantom.grid.upper[2]
    thickness = height if spec.thickness_mm is None or "plates_mm" in phantom.report else spec.thickness_mm
    report: Report = {"thickness_mm": thickness, "uploaded": True}
    if spec.force_N is not None:
        report["force_N"] = spec.force_N
    return Compression(np.zeros((0, 3)), (0.0, thickness), spec.force_N, "converged", report)


def _native(labels: NDArray[np.uint8], axes: Axes) -> NDArray[np.uint8]:
    """A view of an array (z, y, x) along the axes of a file that lead where ``axes`` say."""
    view = labels.transpose(["zyx".index(axis[1]) for axis in axes])
    return view[tuple(slice(None, None, 1 if axis[0] == "+" else -1) for axis in axes)]


def _room(box: Box, spec: UploadedPhantom) -> tuple[NDArray[np.uint8], int]:
    """Air (z, y, x) for what is cut out, and how many voxels of it lie on all sides but the chest wall."""
    sides = (box[along(spec.axes, name)] for name in "zyx")
    nz, ny, nx = (behind - first for first, behind in sides)
    margin = 0 if spec.compressed else MARGIN
    return np.zeros((nz + 2 * margin, ny + 2 * margin, nx + margin), np.uint8), margin


def _spacing(spec: UploadedPhantom) -> tuple[float, float, float]:
    """Voxel edges along (x, y, z), mm."""
    x, y, z = map(spec.edge_mm, "xyz")
    return x, y, z


def _uncompressed_grid(labels: NDArray[np.uint8], spec: UploadedPhantom) -> Grid:
    """y = 0 and z = 0 in the middle."""
    (nz, ny, _), spacing = labels.shape, _spacing(spec)
    return Grid(labels.shape, spacing, (0.0, -ny * spacing[1] / 2, -nz * spacing[2] / 2))


def _compressed_grid(labels: NDArray[np.uint8], spec: UploadedPhantom, gap: paddle.Gap | None) -> Grid:
    """z = 0 on the lower plate, y = 0 in the middle. raises: SpecError where the tissue is above the upper plate"""
    spacing, said = _spacing(spec), spec.thickness_mm
    height, edge = len(labels) * spacing[2], spacing[2]
    if said is not None and gap is not None:
        paddle.check_thickness(said, height, edge)
    if said is not None and said < height - edge:
        raise refused("thickness_mm", said, f"the tissue is {height:g} mm high; at least that, or none")
    return Grid(labels.shape, spacing, (0.0, -labels.shape[1] * spacing[1] / 2, 0.0))


def _left_out(counts: NDArray[np.int64], scan: Survey, spec: UploadedPhantom) -> Report:
    """What of the file is not in the phantom, for its report. counts: voxels of every tissue in the phantom."""
    table, missing = tissue_maps.table(spec.tissues), -counts
    for value, voxels in scan.values.items():
        if table[value] < MAX_TISSUES:
            missing[table[value]] += voxels
    voxel_ml = spec.voxel_volume_mm3 * 1e-3
    volumes = {t.name.lower(): float(missing[t]) * voxel_ml for t in Tissue if t and missing[t] > 0}
    return {"left_out_ml": volumes} if volumes else {}


def _census(labels: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Voxels of every tissue."""
    counts = np.zeros(MAX_TISSUES, np.int64)
    for plane in labels:
        counts += np.bincount(plane.ravel(), minlength=MAX_TISSUES)
    return counts


def _report(counts: NDArray[np.int64], grid: Grid, spec: UploadedPhantom) -> Report:
    """counts: voxels of every tissue."""
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
