"""Projections in the form that every reader knows: Digital Mammography X-Ray Image - For Processing, a file a view.

The geometry of a view stands twice: by the beam vector (distance and positioner angle to the middle of the
chest-wall edge of the detector, both different in every view; detector angles), as the mammography module has it,
and complete in an Isocenter Reference System Sequence, an addition from the Breast Projection object.
"""

from __future__ import annotations

from pydicom.dataset import Dataset
from pydicom.uid import DigitalMammographyXRayImageStorageForProcessing

from simcore.dicom.common import Instance, breast_code, date_time, item, items, set_pixels
from simcore.dicom.geometry import isocenter_item, source_distance
from simcore.dicom.study import (
    MAMMOGRAPHY,
    Study,
    detector_size,
    set_breast_image,
    set_compression,
    set_detector,
    set_exposure,
)
from simcore.dicom.values import decimal


def mammography_image(study: Study, view: int) -> Instance:
    """The image of one view (0-based); Instance Number is view + 1."""
    dataset = study.dataset(MAMMOGRAPHY, DigitalMammographyXRayImageStorageForProcessing, "MG", view + 1)
    describe_view(dataset, study, view)
    _describe_geometry(dataset, study, view)
    dataset.PresentationIntentType = "FOR PROCESSING"
    dataset.ImageType = ["ORIGINAL", "PRIMARY", "TOMO_PROJ"]
    dataset.PatientOrientation = study.frames.patient_orientation()
    dataset.PixelIntensityRelationship = "LIN"
    dataset.PixelIntensityRelationshipSign = 1
    dataset.PhotometricInterpretation = "MONOCHROME1"
    dataset.PresentationLUTShape = "INVERSE"
    study.add_private(dataset, "projection", view=view)
    return set_pixels(dataset, study.stack.data[view : view + 1], study.case.detector_bits)


def describe_view(dataset: Dataset, study: Study, view: int) -> None:
    """What the image of a view says whatever was made of its pixels."""
    set_breast_image(dataset, study)
    dataset.AcquisitionDate = study.spec.date
    dataset.AcquisitionTime = study.spec.time
    dataset.AcquisitionDateTime = date_time(study.spec)
    dataset.AcquisitionNumber = 1
    dataset.ImagesInAcquisition = study.stack.geometry.views
    dataset.ImageLaterality = study.spec.laterality
    dataset.ViewPosition = study.spec.view
    dataset.BodyPartExamined = "BREAST"
    dataset.OrganExposed = "BREAST"
    dataset.AnatomicRegionSequence = breast_code()
    dataset.RescaleIntercept = "0"
    dataset.RescaleSlope = "1"
    dataset.RescaleType = "US"
    _describe_position(dataset, study, view)
    set_detector(dataset, study)
    _describe_field(dataset, study)
    set_compression(dataset, study)
    set_exposure(dataset, study, study.view_share)
    _describe_load(dataset, study)
    dataset.Grid = "NONE"
    dataset.IrradiationEventUID = study.ids.irradiation_event


def _describe_load(dataset: Dataset, study: Study) -> None:
    exposure, share = study.exposure, study.view_share
    dataset.update(item(**exposure.filter()))
    dataset.HalfValueLayer = decimal(exposure.half_value_layer_mm)
    # Whole numbers in these attributes.
    dataset.Exposure = round(exposure.load_mAs * share)
    dataset.ExposureInuAs = round(1000.0 * exposure.load_mAs * share)
    dataset.ExposureTime = round(1000.0 * exposure.seconds * share)
    dataset.XRayTubeCurrent = round(exposure.current_mA)
    dataset.RelativeXRayExposure = 0


def _describe_position(dataset: Dataset, study: Study, view: int) -> None:
    beam = study.beam(view)
    dataset.PositionerType = "MAMMOGRAPHIC"
    dataset.PositionerPrimaryAngle = decimal(beam.primary)
    dataset.PositionerPrimaryAngleDirection = "CC"
    dataset.PositionerSecondaryAngle = decimal(beam.secondary)
    dataset.DistanceSourceToDetector = decimal(beam.length)
    dataset.DistanceSourceToPatient = decimal(beam.support)
    dataset.DistanceSourceToEntrance = decimal(beam.entrance)
    dataset.EstimatedRadiographicMagnificationFactor = decimal(beam.magnification)


def _describe_geometry(dataset: Dataset, study: Study, view: int) -> None:
    """Where the pixels lie against the beam; holds for pixels in the order of the detector."""
    beam = study.beam(view)
    dataset.DetectorPrimaryAngle = decimal(beam.row)
    dataset.DetectorSecondaryAngle = decimal(beam.column)
    dataset.DistanceSourceToIsocenter = source_distance(study.frames, view)
    dataset.IsocenterReferenceSystemSequence = items(isocenter_item(study.frames, view))


def _describe_field(dataset: Dataset, study: Study) -> None:
    edge = decimal(study.stack.geometry.detector.pixel)
    dataset.ImagerPixelSpacing = [edge, edge]
    dataset.FieldOfViewShape = "RECTANGLE"
    dataset.FieldOfViewDimensions = [round(size) for size in detector_size(study)]
    dataset.FieldOfViewOrigin = ["0", "0"]
    dataset.FieldOfViewRotation = "0"
    dataset.FieldOfViewHorizontalFlip = "NO"
