"""Ground truth: the lesions as a binary Segmentation, one segment each, in the frame of the volume."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import SegmentationStorage

from simcore.core.errors import ExportError
from simcore.dicom.common import Instance, dimensions, functional_groups, item, items
from simcore.dicom.lesions import Lesion
from simcore.dicom.limits import MAX_BYTES
from simcore.dicom.objects.segmentation import derivation, describe, segment
from simcore.dicom.study import LESIONS, Study, plane_groups

SOP_CLASS = SegmentationStorage


def shown_lesions(study: Study) -> tuple[Lesion, ...]:
    """The lesions that have voxels in the volume; segment n is the nth of them."""
    return tuple(lesion for lesion in study.lesions if len(lesion.voxels))


def lesion_segmentation(study: Study) -> Instance:
    """Only slices that a lesion lies in have frames: segment by segment, from the support upwards."""
    dataset = study.dataset(LESIONS, SOP_CLASS, "SEG")
    grid = study.volume.grid
    lesions = shown_lesions(study)
    describe(dataset, study, "LESIONS", "lesions of the compressed phantom")
    dataset.SegmentationType = "BINARY"
    dataset.SegmentSequence = Sequence(
        [segment(study, n, lesion.tissue, lesion.name) for n, lesion in enumerate(lesions, start=1)]
    )
    frames = [(n, lesion, k) for n, lesion in enumerate(lesions, start=1) for k in lesion.slices]
    planes = sorted({k for _, _, k in frames})
    dataset.NumberOfFrames = len(frames)
    dimensions(
        dataset,
        study.ids.uid("dimensions", LESIONS),
        (0x0062000B, 0x0062000A, "Referenced Segment Number"),
        (0x00200032, 0x00209113, "Image Position (Patient)"),
    )
    dataset.SharedFunctionalGroupsSequence = items(functional_groups(**plane_groups(study, grid)))
    dataset.PerFrameFunctionalGroupsSequence = Sequence(
        [_frame_groups(study, n, k, planes.index(k) + 1) for n, _, k in frames]
    )
    study.add_private(dataset, "lesions", grid=grid.to_dict(), truth=list(study.phantom.truth))

    dataset.SamplesPerPixel = 1
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.Rows, dataset.Columns = grid.shape[1:]
    dataset.BitsAllocated = dataset.BitsStored = 1
    dataset.HighBit = 0
    dataset.PixelRepresentation = 0
    size = (len(frames) * grid.shape[1] * grid.shape[2] + 7) // 8
    if size > MAX_BYTES:
        raise ExportError(
            f"the segments of {len(lesions)} lesions hold {size} bytes in {len(frames)} frames; a DICOM element holds "
            f"at most {MAX_BYTES}: use thicker slices (reconstruction.slice_mm) or a region about fewer lesions"
        )
    packed = b"".join(_packed(lesion.mask(k, grid.shape[1:]) for _, lesion, k in frames))
    dataset.add_new(0x7FE00010, "OB", packed + b"\0" * (len(packed) % 2))
    return Instance(dataset)


def _frame_groups(study: Study, number: int, k: int, plane: int) -> Dataset:
    return functional_groups(
        FrameContent=item(DimensionIndexValues=[number, plane]),
        PlanePosition=item(ImagePositionPatient=study.frames.image_position(study.volume.grid, k)),
        SegmentIdentification=item(ReferencedSegmentNumber=number),
        DerivationImage=derivation(study, k + 1),
    )


def _packed(masks: Iterator[NDArray[np.bool_]]) -> Iterator[bytes]:
    """Eight pixels a byte, the first in the lowest bit; a frame begins where the one before it ends."""
    rest = np.zeros(0, np.bool_)
    for mask in masks:
        bits = np.concatenate([rest, mask.reshape(-1)])
        whole = len(bits) - len(bits) % 8
        yield np.packbits(bits[:whole], bitorder="little").tobytes()
        rest = bits[whole:]
    yield np.packbits(rest, bitorder="little").tobytes()
