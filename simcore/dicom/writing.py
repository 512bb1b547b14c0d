"""The files of a study, written in order. See ``simcore.dicom.export``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

from numpy.typing import NDArray

from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume
from simcore.core.errors import ExportError
from simcore.core.progress import Progress, part
from simcore.dicom.common import Instance, write
from simcore.dicom.content import array_digest
from simcore.dicom.exported import ExportedStudy
from simcore.dicom.extras import EXTRAS
from simcore.dicom.identity import CaseDescription, Identifiers, content_root
from simcore.dicom.lesions import find_lesions
from simcore.dicom.limits import MAX_BYTES
from simcore.dicom.objects.breast_projection import breast_projection_image
from simcore.dicom.objects.lesion_segmentation import lesion_segmentation
from simcore.dicom.objects.mammography import mammography_image
from simcore.dicom.objects.segmentation import label_map
from simcore.dicom.objects.tomosynthesis import tomosynthesis_image
from simcore.dicom.objects.truth_table import path_table, reader_notes, truth_table
from simcore.dicom.resampling import Lookup, nearest, sample
from simcore.dicom.spec import ExportSpec
from simcore.dicom.study import Study, breast_window

TRUTH_TABLE = "truth.csv"
PATH_TABLE = "file_paths.csv"
_LARGEST = "tomosynthesis.dcm"
_SAMPLES = 100
"""Voxels along each axis that the display window is taken from, at least (where there are so many)."""


def write_study(
    folder: Path,
    spec: ExportSpec,
    case: CaseDescription,
    stack: ProjectionStack,
    volume: Volume,
    compressed: Phantom,
    compression: Compression,
    progress: Progress,
    open_file: Callable[[Path], BinaryIO],
) -> ExportedStudy:
    """As ``simcore.dicom.export``."""
    _check(case, stack, volume)
    lookup = nearest(compressed.grid.moved(z=stack.geometry.support_height), volume.grid)
    progress(0.0, "digests")
    volume_window = _volume_window(volume, compressed, lookup)
    lesions = find_lesions(compressed, stack.geometry.support_height, volume.grid)
    facts = {
        "export": spec.model_dump(),
        "projections": array_digest(stack.data),
        "open_field": float(stack.open_field),
        **({"slab_integral": stack.slab_integral} if stack.slab_integral else {}),
        "geometry": stack.geometry.to_dict(),
        "volume": array_digest(volume.data),
        "grid": volume.grid.to_dict(),
        "values": [float(volume.slope), float(volume.intercept)],
        "labels": array_digest(compressed.labels),
        "labels_grid": compressed.grid.to_dict(),
        "truth": list(compressed.truth),
        "compression": [float(compression.thickness), float(compression.force_N or 0.0)],
    }
    study = Study(
        spec=spec,
        case=case,
        ids=Identifiers(content_root(case, facts)),
        stack=stack,
        volume=volume,
        phantom=compressed,
        lookup=lookup,
        lesions=lesions,
        thickness=compression.thickness,
        force=compression.force_N or 0.0,
        projection_window=_projection_window(stack),
        volume_window=volume_window,
    )
    names = _write_all(folder, study, part(progress, 0.1, 1.0), open_file)
    return ExportedStudy(names, _left_out(study, names), tuple(_notes(study)))


def _check(case: CaseDescription, stack: ProjectionStack, volume: Volume) -> None:
    """Refuse what the format cannot carry, before anything is written."""
    g = stack.geometry
    if stack.data.shape != (g.views, g.detector.ny, g.detector.nx):
        raise ExportError(
            f"projections {stack.data.shape} do not fit the geometry ({g.views}, {g.detector.ny}, {g.detector.nx})"
        )
    if not 10 <= case.detector_bits <= 16:
        raise ExportError(f"detector_bits = {case.detector_bits}: 10 to 16 are allowed")
    largest = max(int(view.max()) for view in stack.data)
    if largest >= 2**case.detector_bits:
        raise ExportError(
            f"the largest pixel value {largest} needs more than detector_bits = {case.detector_bits} bits; "
            f"lower the open-field value or store more bits"
        )
    if volume.data.shape != volume.grid.shape:
        raise ExportError(f"volume {volume.data.shape} and its grid {volume.grid.shape} differ")
    for name, array in (("projections", stack.data), ("volume", volume.data)):
        if array.nbytes > MAX_BYTES:
            raise ExportError(
                f"the {name} hold {array.nbytes} bytes; a DICOM element holds at most {MAX_BYTES}: "
                "take fewer slices or views, or larger pixels"
            )


def _steps(shape: tuple[int, ...]) -> tuple[int, int, int]:
    z, y, x = (max(1, n // _SAMPLES) for n in shape)
    return z, y, x


def _volume_window(volume: Volume, compressed: Phantom, lookup: Lookup) -> tuple[float, float]:
    """Display window from the voxels of the breast on a sparse regular subset (all of them where none is breast)."""
    step = _steps(volume.grid.shape)
    values: NDArray[Any] = volume.data[:: step[0], :: step[1], :: step[2]]
    breast = values[sample(compressed, lookup, step) != 0]
    return breast_window(breast if breast.size else values)


def _projection_window(stack: ProjectionStack) -> tuple[float, float]:
    """Display window from the pixels of the central view that the breast darkens (all of them where none is)."""
    view = stack.data[stack.geometry.views // 2]
    _, y, x = _steps((1, *view.shape))
    values = view[::y, ::x]
    breast = values[values < 0.8 * stack.background]
    return breast_window(breast if breast.size else values)


def _write_all(folder: Path, study: Study, progress: Progress, open_file: Callable[[Path], BinaryIO]) -> list[str]:
    planned = list(_planned(study))
    # The largest first: it may still be hashed while the others are written.
    for number, (name, make) in enumerate(sorted(planned, key=lambda entry: entry[0] != _LARGEST)):
        progress(number / len(planned), name)
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with open_file(path) as file:
            write(file, make(), study.case, study.spec.encoding)
    tables = {TRUTH_TABLE: truth_table(study), PATH_TABLE: path_table(study, _LARGEST)}
    for name, text in tables.items():
        (folder / name).write_text(text, encoding="utf-8", newline="")
    progress(1.0, "written")
    return [*(name for name, _ in planned), *tables]


def _left_out(study: Study, names: list[str]) -> dict[str, str]:
    """Files that a reader of the specification may miss, with the reason."""
    expected = ["lesions.dcm", *(["report.dcm"] if "report" in study.spec.extra_objects else [])]
    return {name: "the volume holds no lesion" for name in expected if name not in names}


def _notes(study: Study) -> Iterator[str]:
    for lesion in study.lesions:
        if not len(lesion.voxels):
            yield f"{lesion.name} lies beyond the volume: it has no box in {TRUTH_TABLE} and no segment"
    yield from reader_notes(study)


def _planned(study: Study) -> Iterator[tuple[str, Callable[[], Instance]]]:
    """Name of every file, and what makes its object when its turn comes."""
    for view in range(study.stack.geometry.views):
        yield f"projections/{view + 1:04d}.dcm", partial(mammography_image, study, view)
    yield "projections.dcm", partial(breast_projection_image, study)
    yield _LARGEST, partial(tomosynthesis_image, study)
    yield "labels.dcm", partial(label_map, study)
    if any(len(lesion.voxels) for lesion in study.lesions):
        yield "lesions.dcm", partial(lesion_segmentation, study)
    for extra in study.spec.extra_objects:
        yield from EXTRAS[extra](study)
