"""What all objects share: patient, study, equipment, pixel module, private block, and how a file is written."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO
from typing import Any, BinaryIO

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.filewriter import dcmwrite
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian

from simcore.dicom.identity import IMPLEMENTATION_UID, CaseDescription, Identifiers
from simcore.dicom.pixels import TRANSFER_SYNTAXES, Frames, write_encoded, write_plain
from simcore.dicom.spec import ExportSpec
from simcore.dicom.values import decimal

PRIVATE_GROUP = 0x0099
PRIVATE_CREATOR = "TOMOSIM 1"
MANUFACTURER = "tomosim (open source)"
MODEL = "tomosim"

_VIEW_CODES = {"CC": ("399162004", "cranio-caudal"), "MLO": ("399368009", "medio-lateral oblique")}


def item(**attributes: Any) -> Dataset:
    """A data set from keywords and values."""
    dataset = Dataset()
    for keyword, value in attributes.items():
        setattr(dataset, keyword, value)
    return dataset


def items(*datasets: Dataset) -> Sequence:
    """A sequence of data sets."""
    return Sequence(list(datasets))


def code(value: str, scheme: str, meaning: str) -> Dataset:
    """A coded concept."""
    return item(CodeValue=value, CodingSchemeDesignator=scheme, CodeMeaning=meaning)


def private_json(dataset: Dataset, document: dict[str, Any]) -> None:
    """Put ``document`` as JSON text into the private block of ``dataset``."""
    block = dataset.private_block(PRIVATE_GROUP, PRIVATE_CREATOR, create=True)
    block.add_new(0x01, "UT", json.dumps(document, sort_keys=True))


def date_time(spec: ExportSpec) -> str:
    """The time of the study as DT."""
    return f"{spec.date}{spec.time}.000000+0000"


def patient_id(spec: ExportSpec, case: CaseDescription) -> str:
    return f"SIM-{spec.patient_id or case.short}"


def view_code(spec: ExportSpec) -> Sequence:
    """View Code Sequence; the modifier sequence is required and empty."""
    value, meaning = _VIEW_CODES[spec.view]
    view = code(value, "SCT", meaning)
    view.ViewModifierCodeSequence = Sequence([])
    return items(view)


def breast_code() -> Sequence:
    return items(code("76752008", "SCT", "Breast"))


def erect() -> Dataset:
    """Patient Orientation Code Sequence of a patient who stands: to be merged into an object."""
    orientation = code("C86043", "NCIt", "erect")
    orientation.PatientOrientationModifierCodeSequence = items(code("10904000", "SCT", "standing"))
    return item(PatientOrientationCodeSequence=items(orientation))


def base_dataset(
    spec: ExportSpec, case: CaseDescription, ids: Identifiers, *, sop_class: str, series: str,
    series_number: int, description: str, modality: str, instance: int = 1,
) -> Dataset:  # fmt: skip
    """Patient, study, series, equipment and SOP common modules, with every mark of a synthetic object."""
    identifier = patient_id(spec, case)
    equipment = {
        "Manufacturer": MANUFACTURER,
        "ManufacturerModelName": MODEL,
        "SoftwareVersions": case.software_version,
    }
    return item(
        SpecificCharacterSet="ISO_IR 192",
        SOPClassUID=sop_class,
        SOPInstanceUID=ids.instance(series, instance),
        InstanceCreationDate=spec.date,
        InstanceCreationTime=spec.time,
        TimezoneOffsetFromUTC="+0000",
        SyntheticData="YES",
        QualityControlSubject="YES",
        PatientName=f"SYNTHETIC^{identifier}",
        PatientID=identifier,
        IssuerOfPatientID="TOMOSIM",
        PatientBirthDate=f"{int(spec.date[:4]) - 50:04d}0101",
        PatientAge="050Y",
        PatientSex="F",
        StudyInstanceUID=ids.study,
        StudyID=case.identity[:16],
        StudyDate=spec.date,
        StudyTime=spec.time,
        StudyDescription=spec.study_description,
        AccessionNumber="",
        ReferringPhysicianName="",
        SeriesInstanceUID=ids.series(series),
        SeriesNumber=series_number,
        SeriesDescription=description,
        SeriesDate=spec.date,
        SeriesTime=spec.time,
        Modality=modality,
        FrameOfReferenceUID=ids.frame_of_reference,
        PositionReferenceIndicator="",
        InstanceNumber=instance,
        ContentDate=spec.date,
        ContentTime=spec.time,
        InstitutionName="SIMULATED",
        InstitutionAddress="none (simulation)",
        StationName="TOMOSIM",
        OperatorsName="SYNTHETIC^",
        DeviceSerialNumber="0",
        **equipment,
        ContributingEquipmentSequence=items(
            item(
                **equipment,
                PurposeOfReferenceCodeSequence=items(code("109100", "DCM", "Synthesizing Equipment")),
                ContributionDescription="software phantom and X-ray simulation; no patient, no X-rays",
            )
        ),
    )


def window(low: float, high: float) -> dict[str, str]:
    """Window Center and Width that show the stored values low..high."""
    width = max(float(np.ceil(high - low)), 1.0)
    return {"WindowCenter": decimal((low + high) / 2), "WindowWidth": decimal(width)}


@dataclass(frozen=True)
class Instance:
    """A DICOM object ready to be written.

    dataset: its attributes. frames: its pixels, written after them in the encoding of the export, or plain where they
    are floats; None where the dataset is complete. transfer_syntax: of a complete dataset.
    """

    dataset: Dataset
    frames: Frames | None = None
    transfer_syntax: str = ExplicitVRLittleEndian


def set_pixels(dataset: Dataset, frames: Frames, bits: int) -> Instance:
    """The image pixel module of uint16 frames (count, rows, columns) of which ``bits`` are stored."""
    dataset.SamplesPerPixel = 1
    dataset.Rows, dataset.Columns = frames[0].shape
    dataset.BitsAllocated = 16
    dataset.BitsStored = bits
    dataset.HighBit = bits - 1
    dataset.PixelRepresentation = 0
    return Instance(dataset, frames)


def write(file: BinaryIO, instance: Instance, case: CaseDescription, encoding: str) -> None:
    """Write a complete DICOM file, from its beginning to its end; nothing in it depends on the clock or the machine.

    encoding: of the frames; see ``ExportSpec.encoding``.
    """
    dataset, frames = instance.dataset, instance.frames
    floats = "BitsStored" not in dataset
    plain = floats or encoding == "none"
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = dataset.SOPClassUID
    meta.MediaStorageSOPInstanceUID = dataset.SOPInstanceUID
    meta.TransferSyntaxUID = instance.transfer_syntax if frames is None or plain else TRANSFER_SYNTAXES[encoding]
    meta.ImplementationClassUID = IMPLEMENTATION_UID
    meta.ImplementationVersionName = f"TOMOSIM_{case.software_version}"[:16]
    dataset.file_meta = meta
    header = BytesIO()
    dcmwrite(header, dataset, enforce_file_format=True)
    file.write(header.getvalue())
    # The pixel data is the last element, so it can be streamed behind the others.
    if frames is not None and plain:
        write_plain(file, (0x7FE0, 0x0008) if floats else (0x7FE0, 0x0010), "OF" if floats else "OW", frames)
    elif frames is not None:
        write_encoded(file, encoding, frames, dataset.BitsStored)


def functional_groups(**macros: Dataset | Iterable[Dataset]) -> Dataset:
    """One item of a functional groups sequence: each keyword (without ``Sequence``) becomes a sequence."""
    groups = Dataset()
    for name, content in macros.items():
        setattr(groups, f"{name}Sequence", items(*([content] if isinstance(content, Dataset) else content)))
    return groups


def dimensions(dataset: Dataset, uid: str, *indices: tuple[int, int | None, str]) -> None:
    """Multi-frame dimension module: (attribute tag, functional group tag, label) of every index."""
    dataset.DimensionOrganizationSequence = items(item(DimensionOrganizationUID=uid))
    entries = []
    for pointer, group, label in indices:
        entry = item(DimensionOrganizationUID=uid, DimensionIndexPointer=pointer, DimensionDescriptionLabel=label)
        if group is not None:
            entry.FunctionalGroupPointer = group
        entries.append(entry)
    dataset.DimensionIndexSequence = Sequence(entries)
