"""Where the plates stop, how the chest wall is held, and how a compression can fail."""

from __future__ import annotations

import json
import pickle
from itertools import pairwise
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from pydantic import ValidationError

from simcore.core.artifacts import Compression, Phantom, TetMesh
from simcore.core.errors import SolverError
from simcore.core.grid import Grid
from simcore.fem import CompressionSpec, compress
from simcore.fem.compression import target_of
from simcore.fem.laws.linear_elastic import LinearElastic
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.published import Published
from simcore.fem.laws.veronda_westmann import VerondaWestmann
from simcore.fem.laws.wellman import Wellman
from simcore.fem.newton import path
from simcore.fem.newton.outcome import FAULTS, REMEDIES, CompressionFailed, message, remedy_of_unverified
from simcore.fem.plates.contact import Plates
from simcore.fem.plates.edge import PlateEdge
from simcore.fem.report.summary import shape_summary
from simcore.mesh.structured import box, half_ellipsoid

ANY_PHANTOM = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
C_CUP = (92.1, 60.2, 67.3, 53.1)


@pytest.fixture(scope="module")
def mesh() -> TetMesh:
    return half_ellipsoid(C_CUP, 6)


@pytest.fixture(scope="module")
def halved(mesh: TetMesh) -> Compression:
    return compress(mesh, ANY_PHANTOM, CompressionSpec())


def test_thickness_is_the_distance_of_the_plates(mesh: TetMesh) -> None:
    result = compress(mesh, ANY_PHANTOM, CompressionSpec(thickness_mm=90.3))
    assert result.thickness == pytest.approx(90.3)
    assert result.report["percent"] == pytest.approx(25.0)
    assert np.ptp((mesh.nodes + result.displacement)[:, 2]) == pytest.approx(90.3, abs=1e-5)


@pytest.mark.parametrize("thickness", [50.0, 130.0])
def test_thickness_beyond_what_percent_allows_is_refused(mesh: TetMesh, thickness: float) -> None:
    with pytest.raises(SolverError, match=f"thickness_mm = {thickness:g}") as error:
        compress(mesh, ANY_PHANTOM, CompressionSpec(thickness_mm=thickness))
    assert error.value.code == "target-not-reached"


@pytest.mark.parametrize("force", [5.0, 60.0, 180.0])
def test_force_is_met_and_the_thickness_found_gives_it_again(mesh: TetMesh, force: float) -> None:
    result = compress(mesh, ANY_PHANTOM, CompressionSpec(force_N=force))
    assert result.force_N == pytest.approx(force, rel=1e-3)
    again = compress(mesh, ANY_PHANTOM, CompressionSpec(thickness_mm=result.thickness))
    assert again.force_N == pytest.approx(result.force_N, rel=1e-3)
    curve = result.report["force_curve"]
    assert all(a["percent"] < b["percent"] and a["force_N"] < b["force_N"] for a, b in pairwise(curve))
    assert len(curve) < 12


def test_force_of_a_stiffening_law_is_met(mesh: TetMesh) -> None:
    material = Wellman(youngs_modulus_kPa=5.0, exponent=10.0)
    result = compress(mesh, ANY_PHANTOM, CompressionSpec(force_N=80.0, percent=60.0, material=material))
    assert result.force_N == pytest.approx(80.0, rel=1e-3)


def test_force_out_of_reach_is_refused_with_what_was_reached(mesh: TetMesh, halved: Compression) -> None:
    with pytest.raises(CompressionFailed, match="force_N = 1000 is wanted") as error:
        compress(mesh, ANY_PHANTOM, CompressionSpec(force_N=1000.0))
    assert error.value.code == "target-not-reached"
    assert error.value.percent == 50.0
    assert error.value.force_N == pytest.approx(halved.force_N, rel=1e-4)


def test_force_limit_names_the_last_good_state(mesh: TetMesh, halved: Compression) -> None:
    spec = CompressionSpec(force_limit_N=100.0, load_steps=10)
    with pytest.raises(CompressionFailed, match="force_limit_N = 100") as error:
        compress(mesh, ANY_PHANTOM, spec)
    failed = error.value
    assert failed.code == "force-limit"
    assert 20 < failed.percent < 50
    assert failed.force_N < 100
    assert failed.force_curve[-1] == {"percent": failed.percent, "force_N": failed.force_N}
    reached = compress(mesh, ANY_PHANTOM, CompressionSpec(percent=failed.percent))
    assert failed.displacement == pytest.approx(reached.displacement, abs=1e-2)
    assert compress(mesh, ANY_PHANTOM, spec.with_(force_limit_N=300.0)).force_N == pytest.approx(
        halved.force_N, rel=1e-4
    )


@pytest.mark.parametrize("load_steps", [1, 6])
def test_a_narrow_breast_that_rolls_aside_is_refused_whatever_the_load_steps(load_steps: int) -> None:
    """130 mm high and 80 mm wide: in the end the symmetric equilibrium is unstable and there are two mirrored ones
    beside it; which one a long step ends in is chance."""
    narrow = half_ellipsoid((80.0, 40.0, 70.0, 60.0), 10)
    with pytest.raises(CompressionFailed, match="buckle") as error:
        compress(narrow, ANY_PHANTOM, CompressionSpec(percent=70.0, load_steps=load_steps))
    assert error.value.code == "unstable-equilibrium"
    assert 60 < error.value.percent < 69


def test_a_slender_column_is_refused_where_it_buckles() -> None:
    """Euler's strain between plates, 4 pi^2/12 (width/length)^2 = 3.3 %; two elements across are stiffer in bending."""
    column = box((6.0, 6.0, 60.0), (2, 2, 20))
    with pytest.raises(CompressionFailed, match="buckle") as error:
        compress(column, ANY_PHANTOM, CompressionSpec(percent=20.0))
    assert error.value.code == "unstable-equilibrium"
    assert 3.3 < error.value.percent < 8


def test_a_failure_survives_its_way_between_processes() -> None:
    failed = CompressionFailed("why", code="force-limit", percent=12.0, force_N=3.0, displacement=np.ones((2, 3)))
    other = pickle.loads(pickle.dumps(failed))
    assert (str(other), other.code, other.percent, other.force_N) == ("why", "force-limit", 12.0, 3.0)
    assert other.displacement.shape == (2, 3)
    assert json.dumps(other.to_dict())


FACTS = {"iterations": 40, "stretch": 0.5, "limit": 30.0, "pressure": 40.0, "force": 10.0, "target": 20.0} | {
    "rounds": 40, "steps": 60, "percent": 30.0, "beyond": 21.0, "further": 31.0
}  # fmt: skip
SPECS = [
    CompressionSpec(chest_wall=wall, percent=percent, material=material, load_steps=100, plate_edge_mm=200.0, **target)
    for wall in get_args(CompressionSpec.model_fields["chest_wall"].annotation)
    for percent in (50.0, 75.0)
    for material in (
        NeoHookean(poissons_ratio=0.3),
        LinearElastic(),
        Wellman(youngs_modulus_kPa=5.0, exponent=10.0),
        Published(source="victre"),
    )
    for target in ({}, {"thickness_mm": 40.0}, {"force_N": 100.0})
]


@pytest.mark.parametrize("code", FAULTS)
def test_every_code_says_what_to_change_and_nothing_that_is_so_already(code: str) -> None:
    assert set(FAULTS) == set(REMEDIES)
    for spec in SPECS:
        text = message(code, spec, **FACTS)
        assert "; take " in text
        advice = text.split("; take ")[1]
        assert f"chest_wall = {spec.chest_wall!r}" not in advice
        assert spec.chest_wall == "free_in_plane" or "'fixed'" not in advice
        assert "load_steps" not in advice  # they are halved by themselves
        assert "plate_edge_mm" not in advice
        assert not (spec.percent == 75.0 and "larger percent" in advice)
        assert not (spec.thickness_mm and "smaller percent" in advice)
        assert not (spec.force_N and "smaller percent" in advice)
        assert not (isinstance(spec.material, NeoHookean) and ("law" in advice or "poissons_ratio" in advice))


def test_every_code_stands_on_the_page_of_the_stages() -> None:
    page = (Path(__file__).parents[3] / "docs" / "stages.md").read_text()
    assert [code for code in FAULTS if f"`{code}`" not in page] == []


def test_a_force_that_no_place_gives_says_so(mesh: TetMesh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path, "_MAX_FORCE_STEPS", 2)
    with pytest.raises(CompressionFailed, match=r"no place between .* = 150 N; take a smaller force_N") as error:
        compress(mesh, ANY_PHANTOM, CompressionSpec(force_N=150.0))
    assert error.value.code == "force-not-met"


def test_load_steps_are_kept_on_the_way_to_a_force(mesh: TetMesh) -> None:
    report = compress(mesh, ANY_PHANTOM, CompressionSpec(force_N=150.0, load_steps=100)).report
    assert max(np.diff([point["percent"] for point in report["force_curve"]])) < 0.5 + 1e-9


def test_what_is_not_confirmed_is_told_what_is_left_to_do() -> None:
    text = remedy_of_unverified(CompressionSpec(load_steps=100, thickness_mm=40.0))
    assert text == "a finer mesh (mesh.edge_length_mm) or a larger thickness_mm"
    assert remedy_of_unverified(CompressionSpec()).startswith("more load_steps, ")


def test_a_wall_that_is_fixed_is_not_advised_to_be() -> None:
    sheet = box((40.0, 4.0, 60.0), (8, 2, 12))
    with pytest.raises(CompressionFailed, match="buckle; take a smaller percent or chest_wall = 'fixed'"):
        compress(sheet, ANY_PHANTOM, CompressionSpec(percent=20.0))
    with pytest.raises(CompressionFailed, match="buckle") as error:
        compress(sheet, ANY_PHANTOM, CompressionSpec(percent=20.0, chest_wall="fixed"))
    assert "chest_wall" not in str(error.value)


@pytest.mark.parametrize(
    ("thickness", "percent", "advice"),
    [
        (10.0, 50.0, "thickness_mm = 30.0 or more$"),
        (20.0, 50.0, "30.0 or more or percent = 67"),
        (70.0, 50.0, "below 60"),
    ],
)
def test_a_thickness_out_of_reach_is_told_what_is_within(thickness: float, percent: float, advice: str) -> None:
    with pytest.raises(SolverError, match=advice):
        target_of(CompressionSpec(thickness_mm=thickness, percent=percent), 60.0)


def test_two_targets_are_refused() -> None:
    with pytest.raises(ValidationError, match="not both"):
        CompressionSpec(thickness_mm=50.0, force_N=100.0)


def test_specifications_from_before_stay_valid() -> None:
    old = '{"percent": 30.0, "material": {"kind": "neo_hookean", "youngs_modulus_kPa": 48.6}, "load_steps": 2}'
    spec = CompressionSpec.model_validate_json(old)
    assert (spec.percent, spec.force_N, spec.thickness_mm, spec.chest_wall) == (30.0, None, None, "free_in_plane")


def test_a_fixed_wall_keeps_its_place_and_stiffens() -> None:
    mesh = half_ellipsoid(C_CUP, 8)
    spec = CompressionSpec(percent=25.0)
    free = compress(mesh, ANY_PHANTOM, spec)
    solution = compress(mesh, ANY_PHANTOM, spec.with_(chest_wall="fixed"))
    assert (solution.displacement[mesh.wall] == 0).all()
    assert solution.report["min_det_F"] > 0
    away = mesh.nodes[:, 0] >= spec.plate_edge_mm
    height = (mesh.nodes + solution.displacement)[away, 2]
    assert solution.plate_z == pytest.approx((height.min(), height.max()), abs=1e-5)
    # Less area under the plates near the wall against more constraint.
    assert 0.5 * free.force_N < solution.force_N < 2 * free.force_N


def test_the_force_at_a_fixed_wall_converges_where_the_plates_have_an_edge() -> None:
    """Flat up to the wall, they would have to make a jump in the displacement: any force comes out."""
    forces = {}
    for edge in (1.0, 40.0):
        spec = CompressionSpec(percent=50.0, chest_wall="fixed", plate_edge_mm=edge)
        forces[edge] = [compress(half_ellipsoid(C_CUP, cells), ANY_PHANTOM, spec).force_N for cells in (12, 16)]
    assert forces[40.0][1] == pytest.approx(forces[40.0][0], rel=0.03)
    assert forces[1.0][1] > 1.08 * forces[1.0][0]


def test_the_edge_clears_the_rim_and_ends_where_it_should(mesh: TetMesh) -> None:
    spec = CompressionSpec(percent=50.0, chest_wall="fixed", plate_edge_mm=40.0)
    result = compress(mesh, ANY_PHANTOM, spec)
    low, high = result.plate_z
    facts = result.report["plates"]
    assert high + facts["upper_rise_mm"] > mesh.nodes[mesh.wall, 2].max()
    assert low - facts["lower_rise_mm"] < mesh.nodes[mesh.wall, 2].min()
    skin = np.unique(mesh.skin)
    share = np.maximum(1 - mesh.nodes[skin, 0] / 40.0, 0.0) ** 2
    height = (mesh.nodes + result.displacement)[skin, 2]
    assert (height - high - facts["upper_rise_mm"] * share).max() == pytest.approx(0, abs=1e-5)
    assert (low - facts["lower_rise_mm"] * share - height).max() == pytest.approx(0, abs=1e-5)
    assert (height - high).max() > 1
    # Plates that have not come to the rim are flat.
    plates = Plates(-100.0, 100.0)
    edge = PlateEdge.of(mesh.nodes, mesh.wall, 40.0).on(plates)
    assert np.abs(edge.heights(mesh.nodes)[0] - plates.lower).max() == 0
    assert np.abs(edge.heights(mesh.nodes)[1] - plates.upper).max() == 0


def test_a_free_wall_has_no_edge(mesh: TetMesh, halved: Compression) -> None:
    other = compress(mesh, ANY_PHANTOM, CompressionSpec(plate_edge_mm=10.0))
    assert other.displacement.tobytes() == halved.displacement.tobytes()


def test_tissue_crushed_against_a_fixed_wall_is_refused() -> None:
    material = VerondaWestmann(youngs_modulus_kPa=20.0, exponent=2.0)
    spec = CompressionSpec(percent=65.0, material=material, chest_wall="fixed", plate_edge_mm=10.0)
    with pytest.raises(CompressionFailed, match="chest_wall = 'free_in_plane'") as error:
        compress(half_ellipsoid(C_CUP, 8), ANY_PHANTOM, spec)
    assert error.value.code == "locked-tissue"
    assert 30 < error.value.percent < 60
    assert error.value.force_N > 0


def test_strain_summary_of_a_block() -> None:
    result = compress(box((30.0, 40.0, 20.0), (3, 4, 2)), ANY_PHANTOM, CompressionSpec(percent=50.0))
    wide = np.ptp(result.report["extent_x_mm"]) / 30
    strain = result.report["log_strain"]
    for quantile in ("p1", "p50", "p99"):
        assert strain["smallest"][quantile] == pytest.approx(np.log(0.5), abs=1e-4)
        assert strain["middle"][quantile] == pytest.approx(np.log(wide), abs=1e-4)
        assert strain["largest"][quantile] == pytest.approx(np.log(wide), abs=1e-4)
    assert strain["shear_p99"] == pytest.approx(0.5 * (np.log(wide) - np.log(0.5)), abs=1e-4)


def test_mesh_quality_of_known_shapes() -> None:
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    quality = shape_summary(regular, np.array([[0, 1, 2, 3]]))
    assert quality["mean_ratio_smallest"] == pytest.approx(1)
    assert quality["dihedral_angle_smallest_degrees"] == pytest.approx(np.degrees(np.arccos(1 / 3)))
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    quality = shape_summary(corner, np.array([[0, 1, 2, 3]]))
    assert quality["dihedral_angle_smallest_degrees"] == pytest.approx(np.degrees(np.arccos(3**-0.5)))
    assert quality["mean_ratio_p50"] == pytest.approx(12 * 0.5 ** (2 / 3) / 9)


def test_report_can_be_stored(halved: Compression) -> None:
    assert json.loads(json.dumps(halved.report)) == halved.report
