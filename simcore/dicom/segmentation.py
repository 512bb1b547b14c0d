"""Ground truth: the tissues of the compressed breast as a Label Map Segmentation in the frame of the volume."""

from __future__ import annotations

from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence
from pydicom.uid import BreastTomosynthesisImageStorage, RLELossless

from simcore.core.artifacts import Phantom
from simcore.core.errors import ExportError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.dicom.common import breast_code, code, dimensions, functional_groups, item, items
from simcore.dicom.resampling import EncodedLabels
from simcore.dicom.study import LABELS, TOMOSYNTHESIS, Study
from simcore.dicom.tomosynthesis import plane_groups

SOP_CLASS = "1.2.840.10008.5.1.4.1.1.66.7"
TRANSFER_SYNTAX = RLELossless

_Code = tuple[str, str, str]
_TISSUE: _Code = ("85756007", "SCT", "Tissue")
_STRUCTURE: _Code = ("91723000", "SCT", "Anatomical Structure")
_ABNORMAL: _Code = ("49755003", "SCT", "Morphologically Abnormal Structure")
_BACKGROUND: _Code = ("125040", "DCM", "Background")

_SEGMENTS: dict[Tissue, tuple[str, _Code, _Code]] = {
    Tissue.AIR: ("Background", _BACKGROUND, _BACKGROUND),
    Tissue.ADIPOSE: ("Adipose tissue", _TISSUE, ("55603005", "SCT", "Fat")),
    Tissue.GLAND: ("Fibroglandular tissue", _TISSUE, ("91772007", "SCT", "Parenchyma")),
    Tissue.SKIN: ("Skin", _STRUCTURE, ("39937001", "SCT", "Skin")),
    Tissue.LIGAMENT: ("Cooper's ligament", _STRUCTURE, ("52082005", "SCT", "Ligament")),
    Tissue.MASS: ("Mass", _ABNORMAL, ("4147007", "SCT", "Mass")),
    Tissue.CALCIFICATION: ("Calcification", _ABNORMAL, ("309587003", "SCT", "Calcification of breast")),
    Tissue.MUSCLE: ("Muscle", _TISSUE, ("91727004", "SCT", "Muscle")),
    Tissue.NIPPLE: ("Nipple", _STRUCTURE, ("24142002", "SCT", "Nipple")),
    Tissue.DUCT: ("Duct", _STRUCTURE, ("DUCT", "99TOMOSIM", "Lactiferous duct")),
    Tissue.TDLU: ("Terminal duct lobular unit", _STRUCTURE, ("TDLU", "99TOMOSIM", "Terminal duct lobular unit")),
    Tissue.ARTERY: ("Artery", _STRUCTURE, ("51114001", "SCT", "Artery")),
    Tissue.VEIN: ("Vein", _STRUCTURE, ("29092000", "SCT", "Vein")),
}
"""Label, property category and property type of every tissue."""

_ALGORITHM = "tomosim ground truth"


def label_map(study: Study, phantom: Phantom, encoded: EncodedLabels, grid: Grid) -> Dataset:
    """Pixel value = segment number = core.tissues.Tissue; one frame a slice of the volume.

    raises: ExportError where the phantom holds a label that is no tissue.
    """
    dataset = study.dataset(LABELS, SOP_CLASS, "SEG")
    slices, rows, columns = grid.shape
    dataset.ImageType = ["DERIVED", "PRIMARY"]
    dataset.ContentLabel = "GROUND_TRUTH"
    dataset.ContentDescription = "tissues of the compressed phantom"
    dataset.ContentCreatorName = "TOMOSIM^"
    dataset.ContentQualification = "RESEARCH"
    dataset.QualityControlImage = "YES"
    dataset.BurnedInAnnotation = "NO"
    dataset.LossyImageCompression = "00"
    dataset.PatientOrientation = study.frames.patient_orientation()
    dataset.SegmentationType = "LABELMAP"
    dataset.SegmentSequence = Sequence([_segment(study, value) for value in (0, *encoded.tissues)])
    dataset.ReferencedSeriesSequence = items(
        item(
            SeriesInstanceUID=study.ids.series(TOMOSYNTHESIS),
            ReferencedInstanceSequence=items(_volume_reference(study)),
        )
    )
    dataset.NumberOfFrames = slices
    dataset.DimensionOrganizationType = "3D"
    dimensions(dataset, study.ids.uid("dimensions", LABELS), (0x00200032, 0x00209113, "Image Position (Patient)"))
    dataset.SharedFunctionalGroupsSequence = items(functional_groups(**plane_groups(study, grid)))
    dataset.PerFrameFunctionalGroupsSequence = Sequence([_frame_groups(study, grid, k) for k in range(slices)])
    study.add_private(dataset, "labels", grid=grid.to_dict(), truth=list(phantom.truth))

    dataset.SamplesPerPixel = 1
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.Rows, dataset.Columns = rows, columns
    dataset.BitsAllocated = dataset.BitsStored = 8
    dataset.HighBit = 7
    dataset.PixelRepresentation = 0
    dataset.PixelPaddingValue = 0
    dataset.add_new(0x7FE00010, "OB", encapsulate(list(encoded.frames)))
    dataset["PixelData"].is_undefined_length = True
    return dataset


def _segment(study: Study, value: int) -> Dataset:
    try:
        label, category, kind = _SEGMENTS[Tissue(value)]
    except ValueError:
        allowed = ", ".join(f"{t.value} {t.name.lower()}" for t in Tissue)
        raise ExportError(f"the phantom holds the label {value}, which is no tissue; allowed: {allowed}") from None
    segment = item(
        SegmentNumber=value,
        SegmentLabel=label,
        SegmentAlgorithmType="AUTOMATIC",
        SegmentAlgorithmName=_ALGORITHM,
        SegmentedPropertyCategoryCodeSequence=items(code(*category)),
        SegmentedPropertyTypeCodeSequence=items(code(*kind)),
    )
    if value:
        segment.AnatomicRegionSequence = breast_code()
        segment.TrackingID = f"{study.case.short}/{label}"
        segment.TrackingUID = study.ids.uid("tracking", value)
    return segment


def _volume_reference(study: Study) -> Dataset:
    return item(
        ReferencedSOPClassUID=BreastTomosynthesisImageStorage,
        ReferencedSOPInstanceUID=study.ids.instance(TOMOSYNTHESIS),
    )


def _frame_groups(study: Study, grid: Grid, k: int) -> Dataset:
    source = _volume_reference(study)
    source.ReferencedFrameNumber = k + 1
    source.SpatialLocationsPreserved = "YES"
    source.PurposeOfReferenceCodeSequence = items(code("121322", "DCM", "Source image for image processing operation"))
    derivation = item(
        DerivationCodeSequence=items(code("113076", "DCM", "Segmentation")),
        SourceImageSequence=items(source),
    )
    return functional_groups(
        FrameContent=item(DimensionIndexValues=[k + 1]),
        PlanePosition=item(ImagePositionPatient=study.frames.image_position(grid, k)),
        DerivationImage=derivation,
    )
