"""Export of a case as one DICOM study: projections in two forms, the volume, tissues and lesions as ground truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from simcore.core.progress import Progress, silent
from simcore.dicom.exported import ExportedStudy
from simcore.dicom.identity import CaseDescription
from simcore.dicom.spec import ExportSpec

if TYPE_CHECKING:  # whoever reads a specification needs no numerics
    from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume

__all__ = ["CaseDescription", "ExportSpec", "ExportedStudy", "export"]


def _open(path: Path) -> BinaryIO:
    return open(path, "wb", buffering=1 << 20)


def export(
    folder: Path,
    spec: ExportSpec,
    case: CaseDescription,
    stack: ProjectionStack,
    volume: Volume,
    compressed: Phantom,
    compression: Compression,
    progress: Progress = silent,
    open_file: Callable[[Path], BinaryIO] = _open,
) -> ExportedStudy:
    """Write a case below ``folder`` (made where missing).

    projections/0001.dcm ...  Digital Mammography X-Ray Image - For Processing, one a view
    projections.dcm           Breast Projection X-Ray Image - For Processing, one frame a view
    tomosynthesis.dcm         Breast Tomosynthesis Image, one frame a slice; real world values in 1/mm
    labels.dcm                Label Map Segmentation, RLE: ``compressed`` (support frame) at the voxels of the volume
    lesions.dcm               Segmentation, one segment a lesion; left out where the volume holds none
    truth.csv, file_paths.csv the lesions as boxes, and the volume they belong to; see simcore.dicom.objects.truth_table
    and what spec.extra_objects asks for; see simcore.dicom.extras

    open_file: opens a file of an object for writing.

    Rows of all images run along x, columns along y. The arrays may be memory maps; pixel data is streamed, so next
    to nothing is held beside them. Nothing depends on the clock: equal arguments give equal bytes.
    raises: ExportError where the data does not fit the format; OSError.
    """
    # Here and not above: the specification is read where nothing may load compiled code.
    from simcore.dicom.writing import write_study

    return write_study(folder, spec, case, stack, volume, compressed, compression, progress, open_file)
