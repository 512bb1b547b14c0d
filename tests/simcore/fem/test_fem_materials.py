"""Every constitutive law against its written-out energy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

from simcore.core.artifacts import Phantom, TetMesh
from simcore.core.errors import SolverError
from simcore.core.grid import Grid
from simcore.fem import CompressionSpec, compress
from simcore.fem.elements.model import Model
from simcore.fem.elements.principal import assemble_principal, principal_axes
from simcore.fem.laws.energies import COEFFICIENTS, add_energy_derivatives, number_of
from simcore.fem.laws.law import Law
from simcore.fem.laws.linear_elastic import LinearElastic
from simcore.fem.laws.mooney_rivlin import MooneyRivlin
from simcore.fem.laws.neo_hookean import NeoHookean
from simcore.fem.laws.of_elements import ElementLaws
from simcore.fem.laws.polynomial import Polynomial
from simcore.fem.laws.veronda_westmann import VerondaWestmann
from simcore.fem.laws.wellman import Wellman
from simcore.mesh.structured import box

ANY_PHANTOM = Phantom(np.ones((1, 1, 1), np.uint8), Grid((1, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)))
Floats = NDArray[np.float64]
Energy = Callable[[Any], Any]
NU = 0.475


def isochoric(stretches: Any) -> tuple[Any, Any, Any]:
    bar = stretches * np.prod(stretches) ** (-1 / 3)
    return bar, np.sum(bar**2) - 3, np.sum(bar**-2.0) - 3


def wellman_energy(E: float, m: float) -> Energy:
    """The integral of E/m (exp(m s) - 1) over s = 1 - exp(-eq); 3 mu in the place of E."""
    modulus = 3 * E / (2 * (1 + NU))

    def energy(stretches: Any) -> Any:
        s = 1 - np.exp(-np.sqrt(2 / 3 * np.sum(np.log(isochoric(stretches)[0]) ** 2)))
        return modulus / m * ((np.exp(m * s) - 1) / m - s)

    return energy


def veronda(stretches: Any) -> Any:
    _, a, b = isochoric(stretches)
    mu = 20.0 / (2 * (1 + NU))
    return mu / 0.5 * (np.exp(0.5 * a) - 1) - mu / 2 * b


def polynomial(stretches: Any) -> Any:
    _, a, b = isochoric(stretches)
    return 1.5 * a + 0.7 * b + 2.5 * a * a + 1.1 * a * b + 3.0 * b * b


CASES: dict[str, tuple[Any, Energy]] = {
    "neo_hookean": (NeoHookean(), lambda s: 60.6 / (4 * (1 + NU)) * isochoric(s)[1]),
    "mooney_rivlin": (MooneyRivlin(c10_kPa=7.0, c01_kPa=3.0), lambda s: 7 * isochoric(s)[1] + 3 * isochoric(s)[2]),
    "polynomial": (
        Polynomial(c10_kPa=1.5, c01_kPa=0.7, c20_kPa=2.5, c11_kPa=1.1, c02_kPa=3.0, poissons_ratio=NU),
        polynomial,
    ),
    "veronda_westmann": (VerondaWestmann(youngs_modulus_kPa=20.0, exponent=0.5, poissons_ratio=NU), veronda),
    "wellman": (Wellman(youngs_modulus_kPa=5.0, exponent=5.0, poissons_ratio=NU), wellman_energy(5.0, 5.0)),
    "hencky": (LinearElastic(), lambda s: 48.6 / (2 * (1 + NU)) * np.sum(np.log(isochoric(s)[0]) ** 2)),
}
EVERY = pytest.mark.parametrize("name", CASES)


def volumetric(bulk: float, J: Any) -> Any:
    return bulk / 2 * ((J * J - 1) / 2 - np.log(J))


def nominal_stress(name: str, stretches: Floats) -> Floats:
    """First Piola-Kirchhoff stress along the axes, kPa, by a complex step through the energy."""
    spec, energy = CASES[name]
    stress = np.empty(3)
    for i in range(3):
        moved = stretches.astype(complex)
        moved[i] += 1e-30j
        stress[i] = (energy(moved) + volumetric(spec.law().bulk, np.prod(moved))).imag / 1e-30
    return stress


def jittered_box(cells: tuple[int, int, int] = (3, 4, 3)) -> TetMesh:
    return box((30.0, 40.0, 20.0), cells, jitter=0.2, generator=np.random.default_rng(5))


def model_of(mesh: TetMesh, *laws: Law) -> Model:
    shares = np.random.default_rng(3).dirichlet(np.ones(len(laws)), len(mesh.tets))
    return Model.of(mesh, ElementLaws.of(laws, shares))


@EVERY
@pytest.mark.parametrize("stretches", [(0.5, 1.1, 1.7), (1.0, 1.0, 1.0), (0.8, 1.2, 1.2), (0.3, 1.9, 1.8)])
def test_derivatives_are_those_of_the_energy(name: str, stretches: tuple[float, float, float]) -> None:
    spec, energy = CASES[name]
    law = spec.law()
    coefficients = np.zeros(COEFFICIENTS)
    coefficients[: len(law.coefficients)] = law.coefficients

    def derivatives(strain: Floats) -> tuple[Floats, Floats]:
        first, second = np.zeros(3), np.zeros((3, 3))
        squared = np.exp(2 * strain)
        add_energy_derivatives(
            number_of(law.energy), coefficients, 2.0, squared, np.sqrt(np.prod(squared)), first, second
        )
        return first, second

    strain = np.log(np.array(stretches))
    first, second = derivatives(strain)
    h, size = 1e-6, max(1.0, law.shear)
    for i in range(3):
        step = h * np.eye(3)[i]
        expected = (energy(np.exp(strain + step)) - energy(np.exp(strain - step))) / h
        assert first[i] == pytest.approx(expected, rel=1e-7, abs=1e-6 * size)
        column = (derivatives(strain + step)[0] - derivatives(strain - step)[0]) / (2 * h)
        assert second[i] == pytest.approx(column, rel=1e-6, abs=1e-4 * size)


@EVERY
@pytest.mark.parametrize("percent", [10.0, 50.0])
def test_block_between_plates_is_in_uniaxial_stress(name: str, percent: float) -> None:
    squeeze = 1 - percent / 100
    wide = brentq(lambda w: nominal_stress(name, np.array([w, w, squeeze]))[0], 0.9, 2.0, xtol=1e-14)
    force = -nominal_stress(name, np.array([wide, wide, squeeze]))[2] * 1e-3 * 1200
    spec = CompressionSpec(percent=percent, material=CASES[name][0], tolerance=1e-9)
    result = compress(jittered_box(), ANY_PHANTOM, spec)
    assert result.force_N == pytest.approx(force, rel=1e-6)
    assert result.report["extent_x_mm"] == pytest.approx([0.0, 30 * wide])


def energy_of_gradient(name: str, F: Floats) -> float:
    energy = CASES[name][1]
    return float(energy(np.linalg.svd(F, compute_uv=False)))


def piola(name: str, F: Floats) -> Floats:
    """Isochoric first Piola-Kirchhoff stress, kPa."""
    P, h = np.empty((3, 3)), 1e-5
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[i, j] = h
        P[i, j] = (energy_of_gradient(name, F + step) - energy_of_gradient(name, F - step)) / (2 * h)
    return P


@EVERY
@pytest.mark.parametrize(
    "gradient",
    [np.eye(3) + 0.6 * np.eye(3)[:, [1, 2, 0]] * [1, 0, 0], np.diag([1.0, 1.0, 0.6]), np.diag([0.7, 1.0, 1.0])],
    ids=["simple shear", "confined along z", "confined along x"],
)
def test_affine_deformation_has_the_exact_stress(name: str, gradient: Floats) -> None:
    mesh = jittered_box((2, 2, 2))
    force = model_of(mesh, CASES[name][0].law()).internal_force(
        mesh.nodes @ (gradient - np.eye(3)).T, np.zeros(len(mesh.nodes))
    )
    side = mesh.nodes[:, 0] == 30.0
    expected = piola(name, gradient)[:, 0] * 1e-3 * 800
    assert force[side].sum(axis=0) == pytest.approx(expected, rel=1e-5, abs=1e-6)
    top = mesh.nodes[:, 2] == 10.0
    assert force[top].sum(axis=0) == pytest.approx(piola(name, gradient)[:, 2] * 1.2, rel=1e-5, abs=1e-6)
    assert np.abs(force.sum(axis=0)).max() < 1e-10


SMALL = {
    **{name: case[0] for name, case in CASES.items()},
    "small": LinearElastic(strain="small"),
    "green_lagrange": LinearElastic(strain="green_lagrange"),
}


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.499])
def test_small_strain_limit(name: str, nu: float) -> None:
    material = SMALL[name].with_(poissons_ratio=nu)
    law = material.law()
    E = 9 * law.bulk * law.shear / (3 * law.bulk + law.shear)
    if "youngs_modulus_kPa" in type(material).model_fields:
        assert material.youngs_modulus_kPa == pytest.approx(E)
    spec = CompressionSpec(percent=0.01, material=material, tolerance=1e-8)
    result = compress(jittered_box((2, 2, 2)), ANY_PHANTOM, spec)
    assert result.force_N == pytest.approx(E * 1e-3 * 1200 * 1e-4, rel=1e-3)
    assert np.ptp(result.report["extent_x_mm"]) / 30 - 1 == pytest.approx(nu * 1e-4, rel=1e-3, abs=1e-8)


def test_the_neo_hookean_kernel_and_the_general_one_agree() -> None:
    mesh = jittered_box((3, 3, 2))
    model = model_of(mesh, NeoHookean().law(), NeoHookean(youngs_modulus_kPa=10.0, poissons_ratio=0.3).law())
    generator = np.random.default_rng(1)
    u, p = generator.normal(0, 0.7, mesh.nodes.shape), generator.normal(0, 0.02, len(mesh.nodes))
    fast, general = model.system(), model.system()
    laws = model.laws
    assert model.assemble(u, p, fast) == assemble_principal(
        u, p, model.tets, model.gradients, model.volumes, laws.numbers, laws.coefficients, laws.fractions,
        model.pattern.block_of, True, general.force, general.node_volume, general.blocks,
    )  # fmt: skip
    for a, b in (
        (fast.force, general.force), (fast.node_volume, general.node_volume), (fast.blocks, general.blocks),
    ):  # fmt: skip
        assert b == pytest.approx(a, rel=1e-9, abs=1e-12 * np.abs(a).max())


TANGENT_LAWS = {
    "a mixture": [case[0].law() for case in CASES.values()],
    "small": [SMALL["small"].law()],
    "green_lagrange": [SMALL["green_lagrange"].law()],
}


@pytest.mark.parametrize("noise", [0.6, 0.0], ids=["any stretches", "two equal stretches"])
@pytest.mark.parametrize("name", TANGENT_LAWS)
def test_tangent_is_the_derivative_of_the_force(name: str, noise: float) -> None:
    mesh = box((30.0, 40.0, 20.0), (2, 2, 2))
    model = model_of(mesh, *TANGENT_LAWS[name])
    generator = np.random.default_rng(7)
    n = len(mesh.nodes)
    u, p = noise * generator.normal(0, 1, (n, 3)), generator.normal(0, 0.05, n)
    if noise == 0.0:
        u = mesh.nodes * [0.2, 0.2, -0.35]
    du, dp = generator.normal(0, 1, (n, 3)), generator.normal(0, 0.1, n)
    system, ahead, behind = model.system(), model.system(), model.system()
    assert model.assemble(u, p, system) > 0.3
    h = 1e-5
    model.assemble(u + h * du, p + h * dp, ahead)
    model.assemble(u - h * du, p - h * dp, behind)
    force_rate, volume_rate = np.zeros((n, 3)), np.zeros(n)
    row = np.repeat(np.arange(n), np.diff(model.pattern.row_start))
    for k, (a, b) in enumerate(zip(row, model.pattern.column, strict=True)):
        force_rate[a] += system.stiffness[k] @ du[b] + system.coupling_upper[k] * dp[b]
        volume_rate[b] += system.coupling_upper[k] @ du[a]
        if a != b:
            force_rate[b] += system.stiffness[k].T @ du[a] + system.coupling_lower[k] * dp[a]
            volume_rate[a] += system.coupling_lower[k] @ du[b]
    assert force_rate == pytest.approx((ahead.force - behind.force) / (2 * h), rel=1e-6, abs=1e-6)
    assert volume_rate == pytest.approx((ahead.node_volume - behind.node_volume) / (2 * h), rel=1e-6, abs=1e-4)


def test_rotation_costs_no_force() -> None:
    mesh = jittered_box((2, 2, 2))
    rotation = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    model = model_of(mesh, *(case[0].law() for case in CASES.values()))
    assert np.abs(model.internal_force(mesh.nodes @ rotation.T - mesh.nodes, np.zeros(len(mesh.nodes)))).max() < 1e-10


def test_principal_axes_of_close_and_far_values() -> None:
    generator = np.random.default_rng(4)
    for spread in (0.0, 1e-12, 1e-6, 0.1, 3.0):
        basis = np.linalg.qr(generator.normal(size=(3, 3)))[0]
        values = np.exp(spread * np.array([0.3, -1.0, 0.9]))
        matrix = basis * values @ basis.T
        matrix = (matrix + matrix.T) / 2
        principal, axes = np.empty(3), np.empty((3, 3))
        principal_axes(matrix.copy(), principal, axes)
        assert np.sort(principal) == pytest.approx(np.sort(values), rel=1e-13)
        assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-14)
        assert (axes * principal) @ axes.T == pytest.approx(matrix, abs=1e-13 * values.max())


def test_st_venant_kirchhoff_follows_its_curve_up_to_its_limit_and_no_further() -> None:
    material = LinearElastic(strain="green_lagrange", poissons_ratio=0.3)
    spec = CompressionSpec(percent=30.0, material=material, tolerance=1e-8)
    result = compress(jittered_box(), ANY_PHANTOM, spec)
    assert result.force_N == pytest.approx(48.6e-3 * 1200 * 0.7 * (1 - 0.49) / 2, rel=1e-6)
    with pytest.raises(SolverError, match=r"0\.577") as error:
        compress(jittered_box(), ANY_PHANTOM, spec.with_(percent=46.0))
    assert error.value.code == "unstable-material"


def test_st_venant_kirchhoff_is_refused_by_its_stretch(monkeypatch: pytest.MonkeyPatch) -> None:
    """An equilibrium beyond the limit is refused even where the solver finds one."""
    monkeypatch.setattr(ElementLaws, "least_stretch", 0.8)
    spec = CompressionSpec(percent=30.0, material=LinearElastic(strain="green_lagrange", poissons_ratio=0.3))
    with pytest.raises(SolverError, match=r"the least is 0\.700") as error:
        compress(jittered_box(), ANY_PHANTOM, spec)
    assert error.value.code == "unstable-material"


def test_small_strain_is_linear_in_the_compression() -> None:
    material = LinearElastic(strain="small", poissons_ratio=0.3)
    result = compress(jittered_box(), ANY_PHANTOM, CompressionSpec(percent=40.0, material=material, tolerance=1e-8))
    assert result.force_N == pytest.approx(48.6e-3 * 1200 * 0.4, rel=1e-6)
    assert np.ptp(result.report["extent_y_mm"]) == pytest.approx(40 * (1 + 0.3 * 0.4))


def test_readings_of_the_papers_alpha() -> None:
    assert NeoHookean.paper() == NeoHookean()
    assert NeoHookean.paper("linear_fit").youngs_modulus_kPa == 48.6
    assert NeoHookean.paper("equibiaxial").youngs_modulus_kPa == 30.3
    # sigma = alpha (l^2 - l^-4) is the true stress of an incompressible equibiaxial stretch with alpha = mu.
    stretch = 1.3
    law = NeoHookean.paper("equibiaxial", poissons_ratio=0.499).law()
    true_stress = law.shear * (stretch**2 - stretch**-4)
    assert true_stress == pytest.approx(10.1 * (stretch**2 - stretch**-4), rel=1e-3)


def test_linear_laws_mix_with_their_own_kind_only() -> None:
    with pytest.raises(SolverError, match="cannot be mixed"):
        ElementLaws.of([NeoHookean().law(), SMALL["small"].law()], np.full((1, 2), 0.5))
    assert SMALL["small"].law().energy.name == "small_strain"
