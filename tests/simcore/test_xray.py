"""The whole way of a case with an X-ray tube: stages, exposure, dose, noise, files, refusals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from pydantic import ValidationError

from simcore import estimate, pipeline, presets
from simcore.core.errors import SpecError
from simcore.dicom import check
from simcore.mesh.spec import LatticeMesh
from simcore.physics.exposure import AirKerma, GlandularDose
from simcore.pipeline.result import CaseResult
from simcore.projection.spec import SlabSpec
from simcore.spec import SimulationSpec
from simcore.store.store import Store
from simcore.xray import XraySpec

TINY = presets.get("tiny")
SPEC = TINY.with_(
    mesh=LatticeMesh(edge_length_mm=12.0),
    acquisition=TINY.acquisition.with_(
        paddle=SlabSpec(material="polycarbonate"), support=SlabSpec(material="carbon-fibre", thickness_mm=1.5)
    ),
    physics=XraySpec(exposure=GlandularDose(mGy=1.5)),
)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> CaseResult:
    return pipeline.run(SPEC, Store(tmp_path_factory.mktemp("store"), min_free_bytes=0))


def with_physics(**changes: Any) -> SimulationSpec:
    assert isinstance(SPEC.physics, XraySpec)
    return SPEC.with_(physics=SPEC.physics.with_(**changes))


def computed(case: CaseResult) -> list[str]:
    return [stage["name"] for stage in case.manifest["stages"] if not stage["cached"]]


def projections(case: CaseResult) -> np.ndarray:
    stage = next(s for s in case.manifest["stages"] if s["name"] == "detection")
    from simcore.store.hashing import FileRef

    return np.load(case.store.path(FileRef(**stage["outputs"]["projections.npy"])))


def test_a_case_tells_beam_exposure_and_dose(first: CaseResult) -> None:
    results = first.manifest["results"]
    assert results["mean_glandular_dose_mGy"] == pytest.approx(1.5, rel=1e-6)
    assert 0.2 < results["mean_glandular_dose_mGy"] / results["incident_air_kerma_mGy"] < 0.5
    assert results["entrance_dose_mGy"] > results["mean_glandular_dose_mGy"]
    assert results["load_mAs"] > 0
    assert results["half_value_layer_mm"] == pytest.approx(0.54, abs=0.03)
    assert set(pipeline.STAGES) == {stage["name"] for stage in first.manifest["stages"]}


def test_the_files_say_so_too(first: CaseResult, tmp_path: Path) -> None:
    first.write(tmp_path)
    assert [str(v) for v in check.verdicts(sorted(tmp_path.rglob("*.dcm"))) if not v.ok] == []
    view = pydicom.dcmread(tmp_path / "projections" / "0001.dcm")
    assert view.KVP == 28
    assert view.AnodeTargetMaterial == "TUNGSTEN"
    assert view.FilterMaterial == "RHODIUM"
    assert float(view.HalfValueLayer) == pytest.approx(first.manifest["results"]["half_value_layer_mm"], abs=1e-3)
    assert 100 * float(view.OrganDose) * 5 == pytest.approx(1.5, rel=1e-3)  # dGy, five views


@pytest.mark.parametrize(
    "changes",
    [
        {"exposure": AirKerma(mGy=2.0)},
        {"detector": XraySpec().detector.with_(noise={"kind": "gaussian-correlated", "realisation": 1})},
    ],
)
def test_another_dose_or_noise_transports_and_projects_nothing_again(
    first: CaseResult, changes: dict[str, Any]
) -> None:
    other = pipeline.run(with_physics(**changes), first.store)
    assert computed(other) == ["detection", "reconstruction", "dicom", "preview"]
    assert not np.array_equal(projections(other), projections(first))


def test_noise_follows_the_exposure(first: CaseResult) -> None:
    """Relative variance beside the breast is inverse to the air kerma."""
    spread = []
    for kerma in (2.0, 8.0):
        views = projections(pipeline.run(with_physics(exposure=AirKerma(mGy=kerma)), first.store)).astype(float)
        beside = views[:, :40, 100:]
        assert 16000 < beside.mean() < 16800  # breast and plates scatter there, too
        spread.append(np.diff(beside, axis=2).var() / beside.mean() ** 2)  # neighbours differ by noise alone
    assert spread[0] / spread[1] == pytest.approx(4.0, rel=0.1)


def test_scatter_brightens_and_no_scatter_leaves_the_dose_alone(first: CaseResult) -> None:
    assert isinstance(SPEC.physics, XraySpec)
    without = pipeline.run(with_physics(transport=SPEC.physics.transport.with_(scatter="none")), first.store)
    assert "projection" not in computed(without)
    least = [np.percentile(projections(case)[2], 2) for case in (first, without)]
    assert 1.1 < least[0] / least[1] < 2.0
    name = "mean_glandular_dose_mGy"
    assert without.manifest["results"][name] == pytest.approx(first.manifest["results"][name], rel=1e-6)


def test_the_same_bytes_for_any_number_of_threads(first: CaseResult, tmp_path: Path, threads: Any) -> None:
    stages = ("projection", "transport", "detection")
    threads(1)
    again = pipeline.run(SPEC, Store(tmp_path, min_free_bytes=0))
    outputs = [{s["name"]: s["outputs"] for s in case.manifest["stages"]} for case in (first, again)]
    for name in stages:
        assert outputs[0][name] == outputs[1][name], name


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"exposure": {"kind": "detector_signal"}}, "detector.gain_DN_per_keV must be given"),
        (
            {
                "exposure": {"kind": "tube_load"},
                "tube": {"measured": {"energies_keV": [20.0], "photons": [1.0]}},
            },
            "tube.measured.mGy_per_mAs",
        ),
        ({"tube": {"kVp": 60.0}}, "less than or equal to 49"),
        ({"materials": {"own": {"air": {"density_g_cm3": 1.0, "mass_fractions": {"H": 1.0}}}}}, "own"),
    ],
)
def test_what_cannot_be_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message.replace(".", r"\.")):
        XraySpec.model_validate(changes)


def test_what_does_not_fit_the_acquisition_is_refused_at_the_estimate() -> None:
    slab = SlabSpec(material="other", attenuation_per_mm=0.1)
    with pytest.raises(SpecError, match=r"acquisition\.paddle\.material = 'other'.*no composition"):
        estimate.check(SPEC.with_(acquisition=SPEC.acquisition.with_(paddle=slab)))
    with pytest.raises(SpecError, match="2 shares for 5 views"):
        estimate.check(with_physics(exposure=AirKerma(view_shares=(1.0, 1.0))))


def test_settings_of_the_ideal_detector_are_told_to_be_unused() -> None:
    detector = SPEC.acquisition.detector.with_(open_field_value=1000.0)
    remarks = estimate.check(SPEC.with_(acquisition=SPEC.acquisition.with_(detector=detector))).remarks
    assert any("open_field_value is not used" in remark for remark in remarks)


@pytest.mark.parametrize("name", [name for name in presets.names() if name.endswith("-xray")])
def test_presets_of_systems_with_xrays_can_be_simulated(name: str) -> None:
    spec = presets.get(name)
    assert isinstance(spec.physics, XraySpec)
    assert estimate.check(spec, 16_000_000_000).seconds > 0
    assert SimulationSpec.parse(spec.model_dump_json()) == spec
