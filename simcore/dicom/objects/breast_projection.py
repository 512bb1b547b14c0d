"""Projections in the form the standard made for them: Breast Projection X-Ray Image - For Processing, multi-frame.

The only object with the complete geometry of every frame: source and detector pose about the isocenter.
"""

from __future__ import annotations

import numpy as np
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import BreastProjectionXRayImageStorageForProcessing

from simcore.dicom.common import (
    Instance,
    date_time,
    dimensions,
    erect,
    functional_groups,
    item,
    items,
    set_pixels,
    window,
)
from simcore.dicom.geometry import detector_motion, isocenter_item, source_distance
from simcore.dicom.study import (
    BREAST_PROJECTION,
    Study,
    detector_size,
    frame_anatomy,
    set_breast_image,
    set_compression,
    set_detector,
    set_exposure,
)
from simcore.dicom.values import decimal

SOP_CLASS = BreastProjectionXRayImageStorageForProcessing
IMAGE_TYPE = ["ORIGINAL", "PRIMARY", "TOMO_PROJ", "NONE"]


def breast_projection_image(study: Study) -> Instance:
    """All views as the frames of one object, in the order of the stack."""
    dataset = study.dataset(BREAST_PROJECTION, SOP_CLASS, "MG")
    views = study.stack.geometry.views
    set_breast_image(dataset, study)
    dataset.PresentationIntentType = "FOR PROCESSING"
    dataset.ImageType = IMAGE_TYPE
    dataset.ContentQualification = "RESEARCH"
    dataset.AcquisitionDateTime = date_time(study.spec)
    dataset.AcquisitionDuration = study.exposure.seconds
    dataset.PositionerMotion = "ROTATION_STEP"
    dataset.PositionerType = "MAMMOGRAPHIC"
    dataset.TypeOfDetectorMotion = detector_motion(study.stack.geometry)
    dataset.PatientOrientation = study.frames.patient_orientation()
    dataset.update(erect())
    dataset.PhotometricInterpretation = "MONOCHROME1"
    dataset.PresentationLUTShape = "INVERSE"
    set_detector(dataset, study)
    # Also here: readers that ignore functional groups find no other size of a pixel.
    edge = decimal(study.stack.geometry.detector.pixel)
    dataset.ImagerPixelSpacing = [edge, edge]
    set_compression(dataset, study)
    set_exposure(dataset, study)
    dataset.update(item(**study.exposure.load(1.0)))

    dataset.NumberOfFrames = views
    dataset.RepresentativeFrameNumber = views // 2 + 1
    dimensions(
        dataset,
        study.ids.uid("dimensions", BREAST_PROJECTION),
        (0x00181510, 0x00189405, "Positioner Primary Angle"),
    )
    dataset.SharedFunctionalGroupsSequence = items(_shared_groups(study))
    dataset.PerFrameFunctionalGroupsSequence = Sequence([_frame_groups(study, view) for view in range(views)])
    study.add_private(dataset, "projections")
    return set_pixels(dataset, study.stack.data, study.case.detector_bits)


def _shared_groups(study: Study) -> Dataset:
    detector = study.stack.geometry.detector
    edge = decimal(detector.pixel)
    return functional_groups(
        FrameAnatomy=frame_anatomy(study),
        PixelValueTransformation=item(RescaleIntercept="0", RescaleSlope="1", RescaleType="US"),
        FrameVOILUT=item(**window(*study.projection_window)),
        FieldOfView=item(
            FieldOfViewShape="RECTANGLE",
            FieldOfViewDimensionsInFloat=list(detector_size(study)),
            FieldOfViewOrigin=["0", "0"],
            FieldOfViewRotation="0",
            FieldOfViewHorizontalFlip="NO",
        ),
        FramePixelDataProperties=item(
            FrameType=IMAGE_TYPE,
            ImagerPixelSpacing=[edge, edge],
            PixelIntensityRelationship="LIN",
            PixelIntensityRelationshipSign=1,
            GeometricalProperties="UNIFORM",
            ImageProcessingApplied="NONE",
        ),
        CollimatorShape=item(
            CollimatorShape="RECTANGULAR",
            CollimatorLeftVerticalEdge=1,
            CollimatorRightVerticalEdge=detector.nx,
            CollimatorUpperHorizontalEdge=1,
            CollimatorLowerHorizontalEdge=detector.ny,
        ),
        XRayGrid=item(Grid="NONE"),
        XRayFilter=item(**study.exposure.filter()),
        IrradiationEventIdentification=item(IrradiationEventUID=study.ids.irradiation_event),
    )


def _frame_groups(study: Study, view: int) -> Dataset:
    frames = study.frames
    beam = study.beam(view)
    load = study.exposure.load(study.view_share)
    angle = float(study.stack.geometry.angles[view])
    # The index of the dimension is the rank of the tube angle: of an arc, the number of the view.
    order = np.argsort(study.stack.geometry.angles, kind="stable").tolist()
    return functional_groups(
        FrameContent=item(
            DimensionIndexValues=[order.index(view) + 1],
            FrameLabel=f"view {view + 1}, tube angle {angle:+.3f} degrees",
            FrameAcquisitionDateTime=date_time(study.spec),
            FrameReferenceDateTime=date_time(study.spec),
            FrameAcquisitionDuration=0.0,
        ),
        PositionerPosition=item(
            PositionerPrimaryAngle=decimal(beam.primary),
            PositionerPrimaryAngleDirection="CC",
            PositionerSecondaryAngle=decimal(beam.secondary),
        ),
        DetectorPosition=item(DetectorPrimaryAngle=decimal(beam.row), DetectorSecondaryAngle=decimal(beam.column)),
        XRayGeometry=item(
            DistanceSourceToDetector=decimal(beam.length),
            DistanceSourceToIsocenter=source_distance(frames, view),
            DistanceSourceToPatient=decimal(beam.support),
            DistanceSourceToEntrance=decimal(beam.entrance),
            EstimatedRadiographicMagnificationFactor=decimal(beam.magnification),
        ),
        XRayAcquisitionDose=item(
            ExposureTimeInms=load["ExposureTimeInms"],
            ExposureInmAs=load["ExposureInmAs"],
            **study.exposure.dose(study.view_share),
        ),
        FrameAcquisition=item(KVP=decimal(study.exposure.peak_kV), XRayTubeCurrentInmA=load["XRayTubeCurrentInmA"]),
        IsocenterReferenceSystem=isocenter_item(frames, view),
    )
