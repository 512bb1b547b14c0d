"""One image of the volume for reading, in the form systems give their generated 2D views: Breast Tomosynthesis Image
with a single frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from numpy.typing import NDArray
from pydicom.uid import BreastTomosynthesisImageStorage

from simcore.dicom.common import (
    Instance,
    code,
    dimensions,
    functional_groups,
    item,
    items,
    set_pixels,
    window,
)
from simcore.dicom.display import DISPLAY_BITS, display_window, hung, synthetic_view
from simcore.dicom.objects.presentation import set_display
from simcore.dicom.objects.tomosynthesis import describe_tomosynthesis, frame_groups
from simcore.dicom.study import SYNTHETIC_2D, Study, frame_anatomy, source_volume
from simcore.dicom.values import decimal

IMAGE_TYPE = ["DERIVED", "PRIMARY", "TOMOSYNTHESIS", "GENERATED_2D"]
_TECHNIQUE = "MAX_IP"


def files(study: Study) -> Iterator[tuple[str, Callable[[], Instance]]]:
    yield "synthetic_2d.dcm", partial(synthetic_2d_image, study)


def synthetic_2d_image(study: Study) -> Instance:
    """The volume seen along z, pixel on pixel with its slices, turned as mammograms are hung."""
    volume, laterality = study.volume, study.spec.laterality
    image = hung(synthetic_view(volume, _breast(study)), laterality)
    dataset = study.dataset(SYNTHETIC_2D, BreastTomosynthesisImageStorage, "MG")
    describe_tomosynthesis(dataset, study, IMAGE_TYPE, _TECHNIQUE)
    set_display(dataset)
    dataset.NumberOfFrames = 1
    dimensions(
        dataset,
        study.ids.uid("dimensions", SYNTHETIC_2D),
        (0x00209056, 0x00209111, "Stack ID"),
        (0x00209057, 0x00209111, "In-Stack Position Number"),
    )
    sx, sy, sz = volume.grid.spacing
    depth = volume.grid.shape[0]
    shared = functional_groups(
        PixelMeasures=item(PixelSpacing=[decimal(sy), decimal(sx)], SliceThickness=decimal(depth * sz)),
        PlaneOrientation=item(ImageOrientationPatient=study.frames.hung_image_orientation(laterality)),
        FrameAnatomy=frame_anatomy(study),
        PixelValueTransformation=item(RescaleIntercept="0", RescaleSlope="1", RescaleType="US"),
        # As of the volume: the default of VOI LUT Function, not the attribute.
        FrameVOILUT=item(**window(*display_window(image))),
        DerivationImage=item(
            DerivationDescription="mean of the slices and of their detail the brightest, along z",
            DerivationCodeSequence=items(code("GENERATED2D", "99TOMOSIM", "Generated 2D view")),
            SourceImageSequence=items(source_volume(study)),
        ),
    )
    position = study.frames.hung_image_position(volume.grid, laterality)
    frame = frame_groups(study, 0, IMAGE_TYPE, _TECHNIQUE, position)
    dataset.SharedFunctionalGroupsSequence = items(shared)
    dataset.PerFrameFunctionalGroupsSequence = items(frame)
    study.add_private(dataset, "synthetic-2d", grid=volume.grid.to_dict())
    return set_pixels(dataset, image[None], DISPLAY_BITS)


def _breast(study: Study) -> NDArray[np.bool_]:
    """bool (rows, columns): pixels above which there is tissue at any height."""
    covered = np.any(study.phantom.labels != 0, axis=0)
    y, x = study.lookup.y, study.lookup.x
    return np.asarray(covered[np.ix_(y, x)] & ((y >= 0)[:, None] & (x >= 0)))
