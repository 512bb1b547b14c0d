"""Copies of the projections made for reading: Digital Mammography X-Ray Image - For Presentation, one file a view."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from pydicom.dataset import Dataset
from pydicom.uid import (
    DigitalMammographyXRayImageStorageForPresentation,
    DigitalMammographyXRayImageStorageForProcessing,
)

from simcore.dicom.common import Instance, code, item, items, set_pixels, window
from simcore.dicom.display import DISPLAY_BITS, display_view, display_window, hung
from simcore.dicom.objects.mammography import describe_view
from simcore.dicom.study import MAMMOGRAPHY, PRESENTATION, Study


def files(study: Study) -> Iterator[tuple[str, Callable[[], Instance]]]:
    for view in range(study.stack.geometry.views):
        yield f"presentation/{view + 1:04d}.dcm", partial(presentation_image, study, view)


def presentation_image(study: Study, view: int) -> Instance:
    """The processed image of one view (0-based), turned as mammograms are hung."""
    stack, laterality = study.stack, study.spec.laterality
    image = hung(display_view(stack.data[view], stack.background, stack.geometry.detector.pixel), laterality)
    dataset = study.dataset(PRESENTATION, DigitalMammographyXRayImageStorageForPresentation, "MG", view + 1)
    describe_view(dataset, study, view)
    dataset.PresentationIntentType = "FOR PRESENTATION"
    dataset.ImageType = ["DERIVED", "PRIMARY", "TOMO_PROJ"]
    dataset.PatientOrientation = study.frames.hung_orientation(laterality)
    dataset.PixelIntensityRelationship = "LOG"
    dataset.PixelIntensityRelationshipSign = -1
    set_display(dataset)
    # Here alone: in raw projections 0 is a signal, that of the densest tissue.
    dataset.PixelPaddingValue = 0
    dataset.update(item(**window(*display_window(image)), VOILUTFunction="LINEAR"))
    dataset.WindowCenterWidthExplanation = "breast"
    # The first pixel is that of another corner of the detector.
    dataset.FieldOfViewRotation = "180" if laterality == "L" else "0"
    dataset.FieldOfViewHorizontalFlip = "YES"
    source = item(
        ReferencedSOPClassUID=DigitalMammographyXRayImageStorageForProcessing,
        ReferencedSOPInstanceUID=study.ids.instance(MAMMOGRAPHY, view + 1),
        SpatialLocationsPreserved="REORIENTED_ONLY",
        PatientOrientation=study.frames.patient_orientation(),
        PurposeOfReferenceCodeSequence=items(code("121322", "DCM", "Source image for image processing operation")),
    )
    dataset.SourceImageSequence = items(source)
    dataset.DerivationDescription = "log, thickness of the breast evened out, detail raised, turned"
    study.add_private(dataset, "presentation", view=view)
    return set_pixels(dataset, image[None], DISPLAY_BITS)


def set_display(dataset: Dataset) -> None:
    """High values are bright."""
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.PresentationLUTShape = "IDENTITY"
