"""The files of a study, written in order. See ``simcore.dicom.export``."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume
from simcore.core.errors import ExportError
from simcore.core.progress import Progress, part
from simcore.dicom.breast_projection import breast_projection_image
from simcore.dicom.common import write
from simcore.dicom.identity import CaseDescription, Identifiers, array_digest, content_root
from simcore.dicom.mammography import mammography_image
from simcore.dicom.resampling import EncodedLabels, Lookup, encode_labels, nearest, sample
from simcore.dicom.segmentation import TRANSFER_SYNTAX as LABEL_SYNTAX
from simcore.dicom.segmentation import label_map
from simcore.dicom.spec import ExportSpec
from simcore.dicom.study import Study, breast_window
from simcore.dicom.tomosynthesis import tomosynthesis_image

_MAX_ELEMENT_BYTES = 2**32 - 2
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
) -> list[str]:
    """As ``simcore.dicom.export``."""
    _check(case, stack, volume)
    lookup = nearest(compressed.grid.moved(z=stack.geometry.support_height), volume.grid)
    progress(0.0, "labels and digests")
    with ThreadPoolExecutor(1) as pool:
        # hashlib releases the interpreter lock, so the digests cost next to no time beside the labels.
        digests = pool.submit(lambda: (array_digest(stack.data), array_digest(volume.data)))
        encoded = encode_labels(compressed, lookup)
        volume_window = _volume_window(volume, compressed, lookup)
        projection_digest, volume_digest = digests.result()
    facts = {
        "export": spec.model_dump(),
        "projections": projection_digest,
        "open_field": float(stack.open_field),
        "geometry": stack.geometry.to_dict(),
        "volume": volume_digest,
        "grid": volume.grid.to_dict(),
        "values": [float(volume.slope), float(volume.intercept)],
        "labels": array_digest(np.frombuffer(b"".join(encoded.frames), np.uint8)[None]),
        "truth": list(compressed.truth),
        "compression": [float(compression.thickness), float(compression.force_N or 0.0)],
    }
    study = Study(
        spec=spec,
        case=case,
        ids=Identifiers(content_root(case, facts)),
        stack=stack,
        thickness=compression.thickness,
        force=compression.force_N or 0.0,
        projection_window=_projection_window(stack),
        volume_window=volume_window,
    )
    return _write_all(folder, study, volume, compressed, encoded, part(progress, 0.3, 1.0))


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
        if array.nbytes > _MAX_ELEMENT_BYTES:
            raise ExportError(
                f"the {name} hold {array.nbytes} bytes; a DICOM element holds at most {_MAX_ELEMENT_BYTES}: "
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
    breast = values[values < 0.8 * stack.open_field]
    return breast_window(breast if breast.size else values)


def _write_all(
    folder: Path, study: Study, volume: Volume, compressed: Phantom, encoded: EncodedLabels, progress: Progress
) -> list[str]:
    (folder / "projections").mkdir(parents=True, exist_ok=True)
    names = []
    views = study.stack.geometry.views
    for view in range(views):
        progress(0.3 * view / views, f"projection {view + 1} of {views}")
        names.append(f"projections/{view + 1:04d}.dcm")
        write(folder / names[-1], mammography_image(study, view), study.case)
    progress(0.3, "projections, multi-frame")
    write(folder / "projections.dcm", breast_projection_image(study), study.case)
    progress(0.5, "volume")
    write(folder / "tomosynthesis.dcm", tomosynthesis_image(study, volume), study.case)
    progress(0.95, "labels")
    labels = label_map(study, compressed, encoded, volume.grid)
    write(folder / "labels.dcm", labels, study.case, LABEL_SYNTAX)
    progress(1.0, "written")
    return [*names, "projections.dcm", "tomosynthesis.dcm", "labels.dcm"]
