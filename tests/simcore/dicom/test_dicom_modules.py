"""Attributes of type 1 and 2 of every module that is mandatory, from the tables of the standard that highdicom brings.

An opinion beside dciodvfy's: other tables, read another way.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pydicom
import pytest
from highdicom._standard_utils import get_iod_module_map, get_module_attribute_map, get_sop_class_iod_map
from pydicom.dataset import Dataset

from tests.support.dicom_case import ALL_EXTRAS, make_case

PIXELS = {"PixelData", "FloatPixelData"}
TREES = {"sr-document-content"}
"""Depends on the value type of every item: highdicom reads it, see test_report."""
EITHER = {"SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence"}
"""A functional group stands in one of them."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("modules")
    make_case(laterality="R", view="MLO", views=2, lesions=True, extras=ALL_EXTRAS).export(folder)
    return folder


def holders(dataset: Dataset, path: list[str]) -> Iterator[Dataset]:
    """All items that a path of sequences leads to."""
    if not path:
        yield dataset
        return
    for entry in dataset.get(path[0]) or []:
        yield from holders(entry, path[1:])


def lacking(dataset: Dataset) -> list[str]:
    """Attributes that should be there, or should have a value."""
    lines = []
    iod = get_sop_class_iod_map()[dataset.SOPClassUID]
    for module in get_iod_module_map()[iod]:
        if module["usage"] != "M" or module["key"] in TREES:
            continue
        for attribute in get_module_attribute_map()[module["key"]]:
            if attribute["type"] in ("1", "2"):
                lines += _lacking(dataset, attribute)
    return sorted(set(lines))


def _lacking(dataset: Dataset, attribute: dict[str, Any]) -> Iterator[str]:
    keyword, path = attribute["keyword"], attribute["path"]
    if keyword in PIXELS or (len(path) == 1 and path[0] in EITHER):
        return
    for holder in holders(dataset, path):
        name = ".".join([*path, keyword])
        if keyword not in holder:
            yield f"{name} (type {attribute['type']}) is missing"
        elif attribute["type"] == "1" and holder[keyword].is_empty:
            yield f"{name} (type 1) is empty"


FILES = (
    "projections/0001.dcm",
    "projections.dcm",
    "tomosynthesis.dcm",
    "labels.dcm",
    "lesions.dcm",
    "presentation/0002.dcm",
    "synthetic_2d.dcm",
    "ct/0003.dcm",
    "attenuation.dcm",
    "report.dcm",
)


@pytest.mark.parametrize("name", FILES)
def test_what_is_required_is_there(folder: Path, name: str) -> None:
    assert lacking(pydicom.dcmread(folder / name)) == []


def test_the_check_sees_what_is_missing(folder: Path) -> None:
    dataset = pydicom.dcmread(folder / "tomosynthesis.dcm")
    del dataset.VolumetricProperties
    dataset.PatientID = ""
    dataset.Manufacturer = ""
    del dataset.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SliceThickness
    lines = lacking(dataset)
    assert lines[0] == "Manufacturer (type 1) is empty"
    assert lines[-1] == "VolumetricProperties (type 1) is missing"
