"""The sum over energies of a pixel, against double precision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from simcore.core.artifacts import Phantom
from simcore.core.errors import GeometryError
from simcore.core.geometry import AcquisitionGeometry, Detector
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.physics.upsampling import spread_over_pixels
from simcore.projection import project, project_spectrum
from simcore.projection.acquisition import geometry_of
from simcore.projection.integrals import basis_integrals
from simcore.projection.materials import attenuation_table
from simcore.projection.spec import AcquisitionSpec, DetectorSpec, PhysicsSpec
from simcore.projection.spectral import Beam, pixel_sums

PIXELS = (40, 50)


def geometry(turned: bool = False) -> AcquisitionGeometry:
    acquisition = AcquisitionSpec(views=3, detector_range_degrees=10.0 if turned else 0.0)
    return replace(geometry_of(acquisition), detector=Detector(*PIXELS, 2.0))


def beam(plates: float = 0.0) -> Beam:
    rng = np.random.default_rng(1)
    return Beam(
        np.linspace(10.0, 28.0, 8),
        rng.random((3, 8)) + 0.1,
        plates * (rng.random(8) + 0.1),
        rng.random((2, 8)),
        np.array([0.5, 1.0]),
        np.array([1.5, 1.0]),
    )


def sums(integrals: NDArray[np.float32], beam: Beam, g: AcquisitionGeometry, view: int) -> NDArray[np.float32]:
    out = np.empty((2, *integrals.shape[1:]), np.float32)
    pixel_sums(integrals, beam, g, view, out[0], out[1])
    return out


def exact(integrals: NDArray[np.float32], b: Beam, g: AcquisitionGeometry, view: int) -> NDArray[np.float64]:
    exponents = np.tensordot(b.curves.T, integrals.astype(np.float64), 1)
    exponents += b.plates[:, None, None] * g.obliquity(view)
    positions = np.array([[g.pixel_position(view, j, i) for i in range(g.detector.nx)] for j in range(g.detector.ny)])
    rays = positions - g.sources[view]
    length = np.linalg.norm(rays, axis=-1)
    cosine = np.abs(rays @ g.normal(view)) / length
    solid = g.detector.pixel**2 * cosine / length**2 * np.interp(cosine, b.cosines, b.absorption)
    return np.asarray(np.tensordot(b.weights, np.exp(-exponents), 1) * solid)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("plates", [0.0, 1.0])
def test_signal_and_variance_are_the_sums_over_energies(turned: bool, plates: float) -> None:
    rng = np.random.default_rng(2)
    integrals = (rng.random((3, *PIXELS)) * np.array([6.0, 3.0, 0.5])[:, None, None]).astype(np.float32)
    g = geometry(turned)
    for view in (0, 1):
        np.testing.assert_allclose(
            sums(integrals, beam(plates), g, view), exact(integrals, beam(plates), g, view), rtol=2e-5
        )


def test_all_of_a_beam_that_meets_a_half_sphere_of_pixels_is_counted() -> None:
    """The solid angles of a large detector sum to that of the field: a closed form of a rectangle."""
    g = replace(geometry(), detector=Detector(400, 200, 2.0))
    one = Beam(np.array([20.0]), np.ones((1, 1)), np.zeros(1), np.ones((2, 1)), np.array([0.1, 1.0]), np.ones(2))
    total = sums(np.zeros((1, 400, 200), np.float32), one, g, 1)[0].sum(dtype=np.float64)
    d, a, b = g.sources[1, 2], 400.0, 400.0
    quarter = np.arctan(a * b / (d * np.sqrt(a * a + b * b + d * d)))
    assert total == pytest.approx(2 * quarter, rel=1e-5)


def test_the_thickest_path_gives_nothing_and_no_overflow() -> None:
    g = replace(geometry(), detector=Detector(1, 1, 2.0))
    signal = sums(np.full((3, 1, 1), 1e6, np.float32), beam(), g, 1)
    assert 0.0 <= signal[0, 0, 0] < 1e-16


def test_the_same_bytes_for_any_number_of_threads(threads: object) -> None:
    rng = np.random.default_rng(2)
    integrals = rng.random((3, *PIXELS)).astype(np.float32)
    outputs = []
    for count in (1, 2):
        threads(count)  # type: ignore[operator]
        outputs.append(sums(integrals, beam(1.0), geometry(True), 0).tobytes())
    assert outputs[0] == outputs[1]


def phantom() -> Phantom:
    """A block of adipose tissue, 20 mm high, with a ball of gland."""
    grid = Grid((20, 60, 40), (1.0, 1.0, 1.0), (0.5, -29.5, 0.5))
    z, y, x = (grid.centres(axis) for axis in "zyx")
    ball = (z[:, None, None] - 10) ** 2 + y[:, None] ** 2 + (x - 20) ** 2 < 64
    labels = np.full(grid.shape, Tissue.ADIPOSE, np.uint8)
    labels[ball] = Tissue.GLAND
    return Phantom(labels, grid)


ACQUISITION = AcquisitionSpec(views=3, detector=DetectorSpec(pixels_y=64, pixels_x=48, pixel_mm=1.5))


def curves() -> tuple[NDArray[np.float64], Beam]:
    """Two materials as their own basis."""
    basis = np.zeros((2, MAX_TISSUES))
    basis[0, Tissue.ADIPOSE] = basis[1, Tissue.GLAND] = 1.0
    energies = np.array([15.0, 20.0, 28.0])
    mu = np.array([[0.11, 0.046, 0.03], [0.18, 0.08, 0.045]])
    weights = np.array([[3.0, 5.0, 2.0], [45.0, 100.0, 60.0]])
    return basis, Beam(energies, mu, np.full(3, 0.05), weights, np.array([0.5, 1.0]), np.ones(2))


def test_one_energy_gives_the_monoenergetic_projections() -> None:
    """The same rays, materials and plates as ``project``, up to its rounding and to solid angles."""
    mu = attenuation_table("johns-yaffe-20keV")
    one = Beam(np.array([20.0]), np.ones((1, 1)), np.zeros(1), np.ones((2, 1)), np.array([0.1, 1.0]), np.ones(2))
    primary = project_spectrum(phantom(), ACQUISITION, mu[None], one)
    stack = project(phantom(), ACQUISITION, PhysicsSpec())
    for view in range(3):
        shape = (ACQUISITION.detector.pixels_y, ACQUISITION.detector.pixels_x)
        ratio = primary.signal[view] / spread_over_pixels(primary.open_signal[view], shape)
        np.testing.assert_allclose(ratio * stack.open_field, stack.data[view], atol=0.7, rtol=3e-5)


def test_the_whole_projection_against_a_sum_over_its_energies() -> None:
    basis, b = curves()
    primary = project_spectrum(phantom(), ACQUISITION, basis, b)
    g = primary.geometry
    for view in range(3):
        integrals = basis_integrals(phantom(), g, view, basis)
        signal, variance = exact(integrals, b, g, view)
        np.testing.assert_allclose(primary.signal[view], signal, rtol=2e-5)
        np.testing.assert_allclose(primary.variance[view] * primary.signal[view], variance, rtol=1e-3)
        open_signal, open_variance = exact(np.zeros_like(integrals), b, g, view)
        for coarse, fine in ((primary.open_signal, open_signal), (primary.open_variance, open_variance)):
            np.testing.assert_allclose(spread_over_pixels(coarse[view], fine.shape), fine, rtol=1e-4)
    assert 0 < primary.report["least_transmission"] < 1


def test_a_shadow_beyond_the_detector_is_refused() -> None:
    small = ACQUISITION.with_(detector=DetectorSpec(pixels_y=20, pixels_x=48, pixel_mm=1.5))
    with pytest.raises(GeometryError, match="beyond the detector"):
        project_spectrum(phantom(), small, *curves())
    assert project_spectrum(phantom(), small.with_(truncation="allow"), *curves()).report["truncated"]
