"""Ground truth: the tissues of the compressed breast as a Label Map Segmentation in the frame of the volume."""

from __future__ import annotations

from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence
from pydicom.uid import RLELossless

from simcore.core.errors import ExportError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.dicom.common import Instance, breast_code, code, dimensions, functional_groups, item, items
from simcore.dicom.resampling import encode_labels
from simcore.dicom.study import LABELS, Study, plane_groups, source_volume, volume_series

SOP_CLASS = "1.2.840.10008.5.1.4.1.1.66.7"

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

_COLOURS: dict[Tissue, tuple[float, float, float]] = {
    Tissue.ADIPOSE: (85.0, 2.0, 50.0),
    Tissue.GLAND: (72.0, 28.0, 18.0),
    Tissue.SKIN: (78.0, 14.0, 24.0),
    Tissue.LIGAMENT: (92.0, -2.0, 12.0),
    Tissue.MASS: (55.0, 70.0, 45.0),
    Tissue.CALCIFICATION: (95.0, -6.0, 36.0),
    Tissue.MUSCLE: (40.0, 48.0, 28.0),
    Tissue.NIPPLE: (55.0, 28.0, 20.0),
    Tissue.DUCT: (62.0, 45.0, -35.0),
    Tissue.TDLU: (70.0, -45.0, 25.0),
    Tissue.ARTERY: (48.0, 72.0, 58.0),
    Tissue.VEIN: (45.0, 8.0, -50.0),
}
"""Colour to show every tissue in: CIELab, L 0 to 100, a and b -128 to 127; all of them lie within sRGB."""

_ALGORITHM = "tomosim ground truth"


def label_map(study: Study) -> Instance:
    """Pixel value = segment number = core.tissues.Tissue; one frame a slice of the volume.

    raises: ExportError where the phantom holds a label that is no tissue.
    """
    encoded = encode_labels(study.phantom, study.lookup)
    dataset = study.dataset(LABELS, SOP_CLASS, "SEG")
    grid = study.volume.grid
    slices, rows, columns = grid.shape
    describe(dataset, study, "GROUND_TRUTH", "tissues of the compressed phantom")
    dataset.SegmentationType = "LABELMAP"
    dataset.SegmentSequence = Sequence([_tissue_segment(study, value) for value in (0, *encoded.tissues)])
    dataset.NumberOfFrames = slices
    dataset.DimensionOrganizationType = "3D"
    dimensions(dataset, study.ids.uid("dimensions", LABELS), (0x00200032, 0x00209113, "Image Position (Patient)"))
    dataset.SharedFunctionalGroupsSequence = items(functional_groups(**plane_groups(study, grid)))
    dataset.PerFrameFunctionalGroupsSequence = Sequence([_frame_groups(study, grid, k) for k in range(slices)])
    study.add_private(dataset, "labels", grid=grid.to_dict(), truth=list(study.phantom.truth))

    dataset.SamplesPerPixel = 1
    dataset.PhotometricInterpretation = "MONOCHROME2"
    dataset.Rows, dataset.Columns = rows, columns
    dataset.BitsAllocated = dataset.BitsStored = 8
    dataset.HighBit = 7
    dataset.PixelRepresentation = 0
    dataset.PixelPaddingValue = 0
    dataset.add_new(0x7FE00010, "OB", encapsulate(list(encoded.frames)))
    dataset["PixelData"].is_undefined_length = True
    return Instance(dataset, transfer_syntax=RLELossless)


def describe(dataset: Dataset, study: Study, label: str, description: str) -> None:
    """What all derived objects in the frame of the volume say of their content."""
    dataset.ImageType = ["DERIVED", "PRIMARY"]
    dataset.ContentLabel = label
    dataset.ContentDescription = description
    dataset.ContentCreatorName = "TOMOSIM^"
    dataset.ContentQualification = "RESEARCH"
    dataset.QualityControlImage = "YES"
    dataset.BurnedInAnnotation = "NO"
    dataset.LossyImageCompression = "00"
    dataset.PatientOrientation = study.frames.patient_orientation()
    dataset.ReferencedSeriesSequence = items(volume_series(study))


def segment(study: Study, number: int, tissue: Tissue, label: str) -> Dataset:
    """One item of the Segment Sequence."""
    _, category, kind = _SEGMENTS[tissue]
    described = item(
        SegmentNumber=number,
        SegmentLabel=label,
        SegmentAlgorithmType="AUTOMATIC",
        SegmentAlgorithmName=_ALGORITHM,
        SegmentedPropertyCategoryCodeSequence=items(code(*category)),
        SegmentedPropertyTypeCodeSequence=items(code(*kind)),
    )
    if tissue != Tissue.AIR:
        described.AnatomicRegionSequence = breast_code()
        described.TrackingID = f"{study.case.short}/{label}"
        described.TrackingUID = study.ids.uid("tracking", label)
        described.RecommendedDisplayCIELabValue = _encoded_colour(_COLOURS[tissue])
    return described


def _encoded_colour(colour: tuple[float, float, float]) -> list[int]:
    """CIELab as DICOM writes it (PS3.3 C.10.7.1.1): the range of each value on 0 to 65535."""
    lightness, a, b = colour
    return [round(65535 * lightness / 100), round(65535 * (a + 128) / 255), round(65535 * (b + 128) / 255)]


def property_type(tissue: Tissue) -> tuple[str, str, str]:
    """The code (value, scheme, meaning) of a tissue."""
    return _SEGMENTS[tissue][2]


def derivation(study: Study, frame: int) -> Dataset:
    """Derivation Image item: segmented from a frame (from 1) of the volume."""
    return item(
        DerivationCodeSequence=items(code("113076", "DCM", "Segmentation")),
        SourceImageSequence=items(source_volume(study, frame)),
    )


def _tissue_segment(study: Study, value: int) -> Dataset:
    try:
        tissue = Tissue(value)
    except ValueError:
        allowed = ", ".join(f"{t.value} {t.name.lower()}" for t in Tissue)
        raise ExportError(f"the phantom holds the label {value}, which is no tissue; allowed: {allowed}") from None
    return segment(study, value, tissue, _SEGMENTS[tissue][0])


def _frame_groups(study: Study, grid: Grid, k: int) -> Dataset:
    return functional_groups(
        FrameContent=item(DimensionIndexValues=[k + 1]),
        PlanePosition=item(ImagePositionPatient=study.frames.image_position(grid, k)),
        DerivationImage=derivation(study, k + 1),
    )
