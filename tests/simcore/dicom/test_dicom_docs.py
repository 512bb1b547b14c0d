"""docs/dicom.md and docs/dicom_conformance.md say what the files hold; the examples run."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset

from tests.support.dicom_case import ALL_EXTRAS, SmallCase, make_case

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture(scope="module")
def case_and_folder(tmp_path_factory: pytest.TempPathFactory) -> tuple[SmallCase, Path]:
    folder = tmp_path_factory.mktemp("docs")
    case = make_case(lesions=True, extras=ALL_EXTRAS)
    case.export(folder / "case")
    return case, folder


def datasets(folder: Path) -> list[Dataset]:
    return [pydicom.dcmread(f, stop_before_pixels=True) for f in sorted(folder.rglob("*.dcm"))]


def test_examples_run(
    case_and_folder: tuple[SmallCase, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    case, folder = case_and_folder
    monkeypatch.chdir(folder)
    first, second = re.findall(r"```python\n(.*?)```", (DOCS / "dicom.md").read_text(), re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(first, "dicom.md", "exec"), names)
    np.testing.assert_allclose(names["attenuation"], case.volume.slope * case.volume.data + case.volume.intercept)
    np.testing.assert_allclose(names["sources"], case.stack.geometry.sources)
    np.testing.assert_allclose(names["line_integrals"], np.log(60000.0 / case.stack.data))
    exec(compile(second, "dicom.md", "exec"), names)
    assert "mean attenuation of fat" in capsys.readouterr().out


def test_every_file_and_option_is_described(case_and_folder: tuple[SmallCase, Path]) -> None:
    case, folder = case_and_folder
    text = (DOCS / "dicom.md").read_text()
    for file in (folder / "case").rglob("*.*"):
        name = file.relative_to(folder / "case").as_posix()
        assert f"`{name}`" in text or "/" in name, name
    for extra in case.spec.extra_objects:
        assert f"| `{extra}` |" in text


def test_classes_and_transfer_syntaxes_are_those_stated(case_and_folder: tuple[SmallCase, Path]) -> None:
    _, folder = case_and_folder
    text = (DOCS / "dicom_conformance.md").read_text()
    stated = set(re.findall(r"Storage[^|\n]*\| (1\.2\.840\.[0-9.]+) \|", text))
    assert stated == {str(d.SOPClassUID) for d in datasets(folder)}
    for line in re.findall(r"^\| .*Storage.*\| 1\.2\.840\.[0-9.]+ \|", text, re.MULTILINE):
        name, uid = (cell.strip() for cell in line.split("|")[1:3])
        assert pydicom.uid.UID(uid).name in (name, uid), name
    syntaxes = set(re.findall(r"\| (1\.2\.840\.10008\.1\.2\.[0-9.]+) \|", text))
    for encoding in ("jpeg-ls", "rle"):
        make_case(views=1, encoding=encoding).export(folder / encoding)
    assert syntaxes == {str(d.file_meta.TransferSyntaxUID) for d in datasets(folder)}


def test_private_schemas_and_codes_are_those_stated(case_and_folder: tuple[SmallCase, Path]) -> None:
    _, folder = case_and_folder
    text = (DOCS / "dicom_conformance.md").read_text()
    files = datasets(folder / "case")
    make_case().export(folder / "all tissues")
    files += datasets(folder / "all tissues")
    schemas = {json.loads(d.private_block(0x0099, "TOMOSIM 1")[0x01].value)["schema"] for d in files}
    assert set(re.findall(r"`(tomosim-[a-z0-9-]+/1)`", text)) == schemas
    codes: set[str] = set()

    def visit(dataset: Dataset, element: DataElement) -> None:
        if element.keyword == "CodingSchemeDesignator" and element.value == "99TOMOSIM":
            codes.add(f"{dataset.CodeValue} ({dataset.CodeMeaning})")

    for d in files:
        d.walk(visit)
    assert codes
    flat = " ".join(text.split())
    assert [c for c in codes if c not in flat] == []
