"""The lesions as a structured report: Comprehensive 3D SR, template 1500, a measurement group (template 1411) each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import BreastTomosynthesisImageStorage, Comprehensive3DSRStorage

from simcore.dicom.common import MODEL, Instance, code, item, items
from simcore.dicom.identity import IMPLEMENTATION_UID
from simcore.dicom.lesions import Lesion
from simcore.dicom.objects.lesion_segmentation import SOP_CLASS as SEGMENTATION
from simcore.dicom.objects.lesion_segmentation import shown_lesions
from simcore.dicom.objects.segmentation import property_type
from simcore.dicom.study import LESIONS, REPORT, TOMOSYNTHESIS, Study
from simcore.dicom.values import decimal

_ENGLISH = ("en", "RFC5646", "English")
_PROCEDURE = ("111409", "DCM", "Digital Mammography")
_LATERALITY = {"L": ("7771000", "SCT", "Left"), "R": ("24028007", "SCT", "Right")}


def files(study: Study) -> Iterator[tuple[str, Callable[[], Instance]]]:
    """Nothing where there is nothing to report."""
    if shown_lesions(study):
        yield "report.dcm", partial(lesion_report, study)


def lesion_report(study: Study) -> Instance:
    """Finding, site and volume of every lesion with its segment."""
    dataset = study.dataset(REPORT, Comprehensive3DSRStorage, "SR")
    # A report has no place of its own.
    del dataset.FrameOfReferenceUID, dataset.PositionReferenceIndicator, dataset.OperatorsName
    dataset.ReferencedPerformedProcedureStepSequence = []
    dataset.PerformedProcedureCodeSequence = []
    dataset.CompletionFlag = "COMPLETE"
    dataset.CompletionFlagDescription = "ground truth of a simulation"
    dataset.VerificationFlag = "UNVERIFIED"
    dataset.PreliminaryFlag = "FINAL"
    dataset.CurrentRequestedProcedureEvidenceSequence = items(_evidence(study))
    dataset.ValueType = "CONTAINER"
    dataset.ConceptNameCodeSequence = items(code("126000", "DCM", "Imaging Measurement Report"))
    dataset.ContinuityOfContent = "SEPARATE"
    dataset.ContentTemplateSequence = items(item(MappingResource="DCMR", TemplateIdentifier="1500"))
    dataset.ContentSequence = Sequence(_content(study))
    study.add_private(dataset, "report", truth=list(study.phantom.truth))
    return Instance(dataset)


def _evidence(study: Study) -> Dataset:
    """The objects that the report speaks of."""
    series = []
    for sop_class, name in ((BreastTomosynthesisImageStorage, TOMOSYNTHESIS), (SEGMENTATION, LESIONS)):
        instance = item(ReferencedSOPClassUID=sop_class, ReferencedSOPInstanceUID=study.ids.instance(name))
        series.append(item(SeriesInstanceUID=study.ids.series(name), ReferencedSOPSequence=items(instance)))
    return item(StudyInstanceUID=study.ids.study, ReferencedSeriesSequence=Sequence(series))


def _content(study: Study) -> list[Dataset]:
    groups = [_group(study, n, lesion) for n, lesion in enumerate(shown_lesions(study), start=1)]
    return [
        _coded("HAS CONCEPT MOD", ("121049", "DCM", "Language of Content Item and Descendants"), _ENGLISH),
        _coded("HAS OBS CONTEXT", ("121005", "DCM", "Observer Type"), ("121007", "DCM", "Device")),
        _content_item("HAS OBS CONTEXT", "UIDREF", ("121012", "DCM", "Device Observer UID"), UID=IMPLEMENTATION_UID),
        _content_item("HAS OBS CONTEXT", "TEXT", ("121013", "DCM", "Device Observer Name"), TextValue=MODEL),
        _coded("HAS CONCEPT MOD", ("121058", "DCM", "Procedure reported"), _PROCEDURE),
        _container(("111028", "DCM", "Image Library"), [_library_group(study)]),
        _container(("126010", "DCM", "Imaging Measurements"), groups),
    ]


def _library_group(study: Study) -> Dataset:
    return _container(("126200", "DCM", "Image Library Group"), [_volume(study)])


def _group(study: Study, number: int, lesion: Lesion) -> Dataset:
    """Lesion ``number``, which is also its segment."""
    segment = item(
        ReferencedSOPClassUID=SEGMENTATION,
        ReferencedSOPInstanceUID=study.ids.instance(LESIONS),
        ReferencedSegmentNumber=number,
    )
    site = _coded("HAS CONCEPT MOD", ("363698007", "SCT", "Finding Site"), ("76752008", "SCT", "Breast"))
    side = _LATERALITY[study.spec.laterality]
    site.ContentSequence = items(_coded("HAS CONCEPT MOD", ("272741003", "SCT", "Laterality"), side))
    volume = item(
        NumericValue=decimal(round(lesion.volume_mm3, 6)),
        FloatingPointValue=float(lesion.volume_mm3),
        MeasurementUnitsCodeSequence=items(code("mm3", "UCUM", "cubic millimeter")),
    )
    group = _container(
        ("125007", "DCM", "Measurement Group"),
        [
            _content_item(
                "HAS OBS CONTEXT",
                "TEXT",
                ("112039", "DCM", "Tracking Identifier"),
                TextValue=f"{study.case.short}/{lesion.name}",
            ),
            _content_item(
                "HAS OBS CONTEXT",
                "UIDREF",
                ("112040", "DCM", "Tracking Unique Identifier"),
                UID=study.ids.uid("tracking", lesion.name),
            ),
            _coded("CONTAINS", ("121071", "DCM", "Finding"), property_type(lesion.tissue)),
            _content_item(
                "CONTAINS", "IMAGE", ("121191", "DCM", "Referenced Segment"), ReferencedSOPSequence=items(segment)
            ),
            _volume(study, ("121233", "DCM", "Source image for segmentation")),
            site,
            _content_item("CONTAINS", "NUM", ("118565006", "SCT", "Volume"), MeasuredValueSequence=items(volume)),
        ],
    )
    group.ContentTemplateSequence = items(item(MappingResource="DCMR", TemplateIdentifier="1411"))
    return group


def _volume(study: Study, name: tuple[str, str, str] | None = None) -> Dataset:
    """The volume as an image of the content tree."""
    volume = item(
        ReferencedSOPClassUID=BreastTomosynthesisImageStorage,
        ReferencedSOPInstanceUID=study.ids.instance(TOMOSYNTHESIS),
    )
    return _content_item("CONTAINS", "IMAGE", name, ReferencedSOPSequence=items(volume))


def _content_item(relation: str, value_type: str, name: tuple[str, str, str] | None, **values: object) -> Dataset:
    content = item(RelationshipType=relation, ValueType=value_type, **values)
    if name is not None:
        content.ConceptNameCodeSequence = items(code(*name))
    return content


def _coded(relation: str, name: tuple[str, str, str], value: tuple[str, str, str]) -> Dataset:
    return _content_item(relation, "CODE", name, ConceptCodeSequence=items(code(*value)))


def _container(name: tuple[str, str, str], content: list[Dataset]) -> Dataset:
    container = _content_item("CONTAINS", "CONTAINER", name, ContinuityOfContent="SEPARATE")
    if content:
        container.ContentSequence = Sequence(content)
    return container
