"""The reconstructed volume: Breast Tomosynthesis Image, multi-frame, one frame a slice from the support upwards."""

from __future__ import annotations

from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import BreastTomosynthesisImageStorage

from simcore.core.artifacts import Volume
from simcore.dicom.common import (
    MANUFACTURER,
    MODEL,
    Instance,
    code,
    date_time,
    dimensions,
    functional_groups,
    item,
    items,
    set_pixels,
    window,
)
from simcore.dicom.geometry import PATIENT_TO_GANTRY
from simcore.dicom.objects import breast_projection
from simcore.dicom.study import (
    BREAST_PROJECTION,
    SERIES_NUMBERS,
    TOMOSYNTHESIS,
    Study,
    detector_size,
    frame_anatomy,
    plane_groups,
    set_breast_image,
    set_compression,
    set_exposure,
)
from simcore.dicom.values import decimal

IMAGE_TYPE = ["DERIVED", "PRIMARY", "TOMOSYNTHESIS", "NONE"]


def tomosynthesis_image(study: Study) -> Instance:
    """The volume as it is stored, with the map of its values to 1/mm."""
    dataset = study.dataset(TOMOSYNTHESIS, BreastTomosynthesisImageStorage, "MG")
    volume = study.volume
    slices = volume.grid.shape[0]
    describe_tomosynthesis(dataset, study, IMAGE_TYPE, "TOMOSYNTHESIS")
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.PresentationLUTShape = "IDENTITY"
    dataset.NumberOfFrames = slices
    dataset.RepresentativeFrameNumber = slices // 2 + 1
    dataset.DimensionOrganizationType = "3D"
    dimensions(
        dataset,
        study.ids.uid("dimensions", TOMOSYNTHESIS),
        (0x00209056, 0x00209111, "Stack ID"),
        (0x00209057, 0x00209111, "In-Stack Position Number"),
    )
    dataset.SharedFunctionalGroupsSequence = items(_shared_groups(study, volume))
    dataset.PerFrameFunctionalGroupsSequence = Sequence(
        [
            frame_groups(study, k, IMAGE_TYPE, "TOMOSYNTHESIS", study.frames.image_position(volume.grid, k))
            for k in range(slices)
        ]
    )
    study.add_private(
        dataset,
        "volume",
        grid=volume.grid.to_dict(),
        value_slope=volume.slope,
        value_intercept=volume.intercept,
        value_unit="1/mm",
    )
    return set_pixels(dataset, volume.data, 16)


def describe_tomosynthesis(dataset: Dataset, study: Study, image_type: list[str], technique: str) -> None:
    """What every image reconstructed from the projections says of its making."""
    set_breast_image(dataset, study)
    dataset.ImageType = image_type
    dataset.PixelPresentation = "MONOCHROME"
    dataset.VolumetricProperties = "VOLUME"
    dataset.VolumeBasedCalculationTechnique = technique
    dataset.ContentQualification = "RESEARCH"
    dataset.RecognizableVisualFeatures = "NO"
    dataset.ImageToEquipmentMappingMatrix = [decimal(value) for value in PATIENT_TO_GANTRY]
    dataset.EquipmentCoordinateSystemIdentification = "ISOCENTER"
    dataset.SourceIrradiationEventSequence = items(item(IrradiationEventUID=study.ids.irradiation_event))
    dataset.ContributingSourcesSequence = items(_contributing_source(study))
    dataset.XRay3DAcquisitionSequence = items(_acquisition(study))
    dataset.XRay3DReconstructionSequence = items(
        item(
            ApplicationName=MODEL,
            ApplicationVersion=study.case.software_version,
            ApplicationManufacturer=MANUFACTURER,
            AlgorithmType=study.case.reconstruction_kind,
            AlgorithmDescription=study.case.reconstruction,
            AcquisitionIndex=[1],
        )
    )


def _projection_reference(study: Study) -> Dataset:
    return item(
        ReferencedSOPClassUID=breast_projection.SOP_CLASS,
        ReferencedSOPInstanceUID=study.ids.instance(BREAST_PROJECTION),
    )


def _contributing_source(study: Study) -> Dataset:
    geometry = study.stack.geometry
    edge = decimal(geometry.detector.pixel)
    instance = _projection_reference(study)
    instance.InstanceNumber = 1
    series = item(
        SeriesInstanceUID=study.ids.series(BREAST_PROJECTION),
        SeriesNumber=SERIES_NUMBERS[BREAST_PROJECTION],
        ReferencedInstanceSequence=items(instance),
    )
    reference = item(StudyInstanceUID=study.ids.study, ReferencedSeriesSequence=items(series))
    return item(
        AcquisitionDateTime=date_time(study.spec),
        Manufacturer=MANUFACTURER,
        ManufacturerModelName=MODEL,
        DeviceSerialNumber="0",
        SoftwareVersions=study.case.software_version,
        DetectorType="DIRECT",
        DetectorID="SIMULATED",
        DateOfLastDetectorCalibration=study.spec.date,
        TimeOfLastDetectorCalibration=study.spec.time,
        DetectorElementSpacing=[edge, edge],
        Rows=geometry.detector.ny,
        Columns=geometry.detector.nx,
        BitsStored=study.case.detector_bits,
        LossyImageCompression="00",
        ContributingSOPInstancesReferenceSequence=items(reference),
    )


def _acquisition(study: Study) -> Dataset:
    geometry = study.stack.geometry
    central = study.beam(geometry.views // 2)
    primary = [study.beam(view).primary for view in range(geometry.views)]
    acquisition = item(
        SourceImageSequence=items(_projection_reference(study)),
        DistanceSourceToDetector=decimal(geometry.source_to_detector),
        DistanceSourceToPatient=decimal(geometry.source_to_detector - geometry.support_height),
        EstimatedRadiographicMagnificationFactor=decimal(central.magnification),
        FieldOfViewShape="RECTANGLE",
        FieldOfViewDimensionsInFloat=list(detector_size(study)),
        FieldOfViewOrigin=["0", "0"],
        FieldOfViewRotation="0",
        FieldOfViewHorizontalFlip="NO",
        **study.exposure.filter(),
        Grid="NONE",
        HalfValueLayer=decimal(study.exposure.half_value_layer_mm),
        DetectorTemperature="0",
        DetectorBinning=["1", "1"],
        XRayReceptorType="DIGITAL_DETECTOR",
        **study.exposure.load(1.0),
        PrimaryPositionerScanStartAngle=primary[0],
        PrimaryPositionerScanArc=primary[-1] - primary[0],
        StartAcquisitionDateTime=date_time(study.spec),
        EndAcquisitionDateTime=date_time(study.spec),
        PerProjectionAcquisitionSequence=Sequence(
            [_projection_acquisition(study, view) for view in range(geometry.views)]
        ),
    )
    set_compression(acquisition, study)
    set_exposure(acquisition, study)
    return acquisition


def _projection_acquisition(study: Study, view: int) -> Dataset:
    beam = study.beam(view)
    detector = study.stack.geometry.detector
    return item(
        KVP=decimal(study.exposure.peak_kV),
        RelativeXRayExposure=0,
        PositionerPrimaryAngle=decimal(beam.primary),
        PositionerPrimaryAngleDirection="CC",
        PositionerSecondaryAngle=decimal(beam.secondary),
        **study.exposure.load(study.view_share),
        FrameAcquisitionDuration=0.0,
        CollimatorShape="RECTANGULAR",
        CollimatorLeftVerticalEdge=1,
        CollimatorRightVerticalEdge=detector.nx,
        CollimatorUpperHorizontalEdge=1,
        CollimatorLowerHorizontalEdge=detector.ny,
        IrradiationEventUID=study.ids.irradiation_event,
    )


def _shared_groups(study: Study, volume: Volume) -> Dataset:
    source = _projection_reference(study)
    source.PurposeOfReferenceCodeSequence = items(code("121322", "DCM", "Source image for image processing operation"))
    derivation = item(
        DerivationDescription=f"{study.case.reconstruction}; {study.exposure.remark}",
        DerivationCodeSequence=items(code("TOMORECON", "99TOMOSIM", "Tomosynthesis reconstruction")),
        SourceImageSequence=items(source),
    )
    values = item(
        RealWorldValueFirstValueMapped=0,
        RealWorldValueLastValueMapped=65535,
        RealWorldValueIntercept=float(volume.intercept),
        RealWorldValueSlope=float(volume.slope),
        LUTExplanation="linear attenuation coefficient",
        LUTLabel="MU",
        MeasurementUnitsCodeSequence=items(code("/mm", "UCUM", "/millimeter")),
    )
    return functional_groups(
        **plane_groups(study, volume.grid),
        FrameAnatomy=frame_anatomy(study),
        PixelValueTransformation=item(RescaleIntercept="0", RescaleSlope="1", RescaleType="US"),
        # Without VOI LUT Function, whose default is LINEAR: cornerstone 5 reads the first letter of it and throws.
        FrameVOILUT=item(**window(*study.volume_window)),
        DerivationImage=derivation,
        RealWorldValueMapping=values,
    )


def frame_groups(study: Study, k: int, image_type: list[str], technique: str, position: list[str]) -> Dataset:
    """Functional groups of frame ``k`` (0-based) of an image in the form of a volume.

    technique: Volume Based Calculation Technique. position: Image Position (Patient).
    """
    return functional_groups(
        FrameContent=item(
            StackID="1",
            InStackPositionNumber=k + 1,
            DimensionIndexValues=[1, k + 1],
            FrameAcquisitionDateTime=date_time(study.spec),
            FrameReferenceDateTime=date_time(study.spec),
            FrameAcquisitionDuration=0.0,
        ),
        # Validators do not take this macro from the shared groups.
        XRay3DFrameType=item(
            FrameType=image_type,
            PixelPresentation="MONOCHROME",
            VolumetricProperties="VOLUME",
            VolumeBasedCalculationTechnique=technique,
            ReconstructionIndex=1,
        ),
        PlanePosition=item(ImagePositionPatient=position),
    )
