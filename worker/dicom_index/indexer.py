"""Puts the DICOM files of cases that succeeded into the index: attributes only, no pixel is read."""

from __future__ import annotations

import json
import logging
import threading
from typing import Any

from pydicom.datadict import tag_for_keyword
from pydicom.dataset import Dataset

from simcore.core.errors import StoreError
from simcore.store.hashing import FileRef
from simcore.store.store import Store
from worker.dicom_index.files import open_stored, read_header
from worker.dicom_index.index import LEVELS, DicomIndex, Entry, Json
from worker.records.dicom import KEYS, TABLES, Level
from worker.upkeep.repeat import Repeated

log = logging.getLogger(__name__)

SUFFIX = ".dcm"
INTERVAL_SECONDS = 3.0
WAIT_SECONDS = 10.0
"""How long a search waits for another thread that fills the index before it answers from what is there."""

LOST = ("object-missing", "object-corrupt")
"""What the store says of a file that will never be there again; after anything else it is asked later."""

MAX_ATTRIBUTE_CHARACTERS = 1000
"""A longer attribute (of the JSON text) is not in the index; the metadata of the instance have it."""


def _tags(*keywords: str) -> frozenset[str]:
    tags = [tag_for_keyword(keyword) for keyword in keywords]
    return frozenset(f"{tag:08X}" for tag in tags if tag is not None)


_EVERY_LEVEL = _tags("SpecificCharacterSet", "TimezoneOffsetFromUTC")
_STUDY = _EVERY_LEVEL | _tags(
    "PatientName", "PatientID", "IssuerOfPatientID", "PatientBirthDate", "PatientSex", "PatientAge", "PatientComments",
    "StudyInstanceUID", "StudyDate", "StudyTime", "AccessionNumber", "StudyID", "ReferringPhysicianName",
    "StudyDescription", "QualityControlSubject",
)  # fmt: skip
_SERIES = _EVERY_LEVEL | _tags(
    "Modality", "SeriesInstanceUID", "SeriesNumber", "SeriesDescription", "SeriesDate", "SeriesTime", "ProtocolName",
    "BodyPartExamined", "Laterality", "FrameOfReferenceUID", "OperatorsName", "Manufacturer", "ManufacturerModelName",
    "InstitutionName", "StationName", "SoftwareVersions", "DeviceSerialNumber",
)  # fmt: skip
_LEFT_OUT = _tags("SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence")


class Indexer:
    """Fills the index; any number of threads and processes may do so at once."""

    def __init__(self, index: DicomIndex, store: Store) -> None:
        self.index = index
        self.store = store
        self._filling = threading.Lock()
        self._repeated = Repeated("dicom-indexer", self.catch_up, INTERVAL_SECONDS)
        self.start, self.stop = self._repeated.start, self._repeated.stop

    def catch_up(self) -> None:
        """Puts every case that succeeded into the index, the oldest first: what came last is shown first."""
        if not self.index.missing() or not self._filling.acquire(timeout=WAIT_SECONDS):
            return
        done = set()
        try:
            while (missing := self.index.missing()) and not self._repeated.stopping.is_set():
                identifier, manifest = missing
                if identifier in done:
                    raise RuntimeError(f"the case {identifier} cannot be put into the DICOM index")
                done.add(identifier)
                self._add(identifier, manifest)
        except StoreError:
            # What is there already can be searched all the same.
            log.exception("the store does not answer: the DICOM index is not complete")
        finally:
            self._filling.release()

    def _add(self, identifier: str, manifest: Json) -> None:
        entries = []
        problems = []
        for name, ref in (manifest or {}).get("files", {}).items():
            if not name.endswith(SUFFIX):
                continue
            try:
                entries.append(read_entry(self.store, name, FileRef(**ref)))
            except StoreError as error:
                if error.code not in LOST:
                    raise
                problems.append(f"{name}: {error}")
            except (ValueError, AttributeError, OSError) as error:
                problems.append(f"{name}: {error}")
        if problems:
            log.warning("not in the DICOM index", extra={"simulation": identifier, "files": problems[:5]})
        self.index.add(identifier, entries, "; ".join(problems)[:2000] or None)


def read_entry(store: Store, name: str, ref: FileRef) -> Entry:
    """What the index keeps of a file. raises: ValueError where it is no DICOM object, OSError"""
    with open_stored(store, ref) as file:
        header = read_header(file)
    for keyword in ("StudyInstanceUID", "SeriesInstanceUID", "SOPInstanceUID", "SOPClassUID"):
        if not header.dataset.get(keyword):
            raise ValueError(f"no {keyword}")
    columns = {level: columns_of(header.dataset, level) for level in LEVELS}
    return Entry(name, ref, columns, attributes_by_level(header.dataset), header.transfer_syntax, header.pixels)


def columns_of(dataset: Dataset, level: Level) -> Json:
    """What is searched at a level: column and value."""
    values: Json = {}
    for keyword, key in KEYS.items():
        if key.column.table is not TABLES[level]:
            continue
        value = dataset.get(keyword)
        if key.kind == "number":
            values[key.column.name] = None if value is None else int(value)
        else:
            length: int = key.column.type.length  # type: ignore[attr-defined]
            values[key.column.name] = "" if value is None else str(value)[:length]
    return values


def attributes_by_level(dataset: Dataset) -> dict[Level, Json]:
    """The attributes of study, series and instance in the DICOM JSON model, without the long ones."""
    attributes: dict[Level, dict[str, Any]] = {"study": {}, "series": {}, "instance": {}}
    for element in dataset:
        tag = f"{element.tag:08X}"
        if tag in _LEFT_OUT or element.tag.is_private:
            continue
        model = element.to_json_dict(None, 0)
        if len(json.dumps(model)) > MAX_ATTRIBUTE_CHARACTERS:
            continue
        if tag in _STUDY:
            attributes["study"][tag] = model
        if tag in _SERIES:
            attributes["series"][tag] = model
        if tag not in _STUDY | _SERIES or tag in _EVERY_LEVEL:
            attributes["instance"][tag] = model
    return attributes
