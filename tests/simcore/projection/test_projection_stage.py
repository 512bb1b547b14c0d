"""The projection stage: geometry, attenuation tables, signal, refusals."""

from __future__ import annotations

import re

import numpy as np
import pytest

from simcore.core.artifacts import Phantom
from simcore.core.errors import Cancelled, GeometryError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.projection import geometry_of, project
from simcore.projection.integrals import line_integrals
from simcore.projection.materials import attenuation_table
from simcore.projection.schedule import spread
from simcore.projection.signal import attenuation, pixel_values
from simcore.projection.spec import AcquisitionSpec, DetectorSpec, PhysicsSpec

SMALL = AcquisitionSpec(views=3, detector=DetectorSpec(pixels_y=100, pixels_x=60, pixel_mm=1.5))


@pytest.fixture(scope="module")
def block():
    """40 mm of random tissue behind an air margin."""
    rng = np.random.default_rng(2)
    labels = rng.integers(1, 4, (20, 40, 30)).astype(np.uint8)
    labels[:, :, 25:] = 0
    labels[9:11, 20:22, 10:12] = Tissue.CALCIFICATION
    return Phantom(labels, Grid(labels.shape, (2.0, 2.0, 2.0), (0.0, -40.0, 0.0)))


def test_angles_are_equiangular_and_symmetric():
    geometry = geometry_of(AcquisitionSpec(views=15, angular_range_degrees=40.0))
    assert geometry.angles[0] == -20.0
    assert geometry.angles[7] == 0.0
    assert np.array_equal(geometry.angles, -geometry.angles[::-1])
    assert np.allclose(np.diff(geometry.angles), 40.0 / 14, atol=1e-12)
    assert geometry.stationary
    assert np.allclose(geometry.sources[7], [0.0, 0.0, 660.0])
    radius = np.linalg.norm(geometry.sources - [0.0, 0.0, 40.0], axis=1)
    assert np.allclose(radius, 620.0)
    assert geometry.sources[-1, 1] == pytest.approx(620.0 * np.sin(np.deg2rad(20.0)))


def test_single_view_is_central():
    geometry = geometry_of(AcquisitionSpec(views=1, detector_range_degrees=4.0))
    assert geometry.angles.tolist() == [0.0]
    assert geometry.stationary


def test_turning_detector_follows_the_tube():
    geometry = geometry_of(AcquisitionSpec(views=5, detector_range_degrees=4.2))
    assert geometry.detector_angles.tolist() == pytest.approx([-2.1, -1.05, 0.0, 1.05, 2.1])


def test_isocenter_above_the_source_is_refused():
    with pytest.raises(GeometryError, match="isocenter_height_mm = 400"):
        geometry_of(AcquisitionSpec(isocenter_height_mm=400.0, source_to_detector_mm=300.0))


def test_attenuation_tables():
    paper = attenuation_table("johns-yaffe-20keV")
    assert paper[Tissue.ADIPOSE] == 0.0456
    assert paper[Tissue.GLAND] == paper[Tissue.SKIN] == paper[Tissue.LIGAMENT] == 0.0802
    assert paper[Tissue.MASS] == 0.0844
    icru = attenuation_table("icru-20keV")
    assert icru[Tissue.ADIPOSE] == pytest.approx(0.0513, abs=5e-5)
    assert icru[Tissue.GLAND] == pytest.approx(0.08005, abs=5e-6)
    for table in (paper, icru):
        assert table[Tissue.AIR] == 0.0
        assert (table[1 : len(Tissue)] > 0).all()
        assert not table[len(Tissue) :].any()
    with pytest.raises(ValueError, match=r"johns-yaffe-20keV"):
        attenuation_table("lead")


def test_polynomial_exponential():
    x = np.concatenate([np.linspace(0, 16, 4001), np.linspace(16, 40, 101)])
    values = np.array([attenuation(value) for value in x])
    assert np.abs(values - np.exp(-x)).max() < 1e-12
    assert np.abs(values[:4001] / np.exp(-x[:4001]) - 1).max() < 1e-6


def test_pixel_values_are_rounded_and_clipped():
    integrals = np.array([[0.0, 1e-6, 1.0, 5.0, 12.0, 100.0, -1e-7]], np.float32)
    out = np.empty(integrals.shape, np.uint16)
    pixel_values(integrals, 60000.0, 16, out)
    assert out.tolist() == [[60000, 60000, 22073, 404, 0, 0, 60000]]
    pixel_values(integrals, 1030.4, 10, out)
    assert out[0, 0] == 1023


@pytest.mark.parametrize("sampling", ["exact", "trilinear"])
def test_signal_is_the_exponential_of_the_integrals(block, sampling):
    physics = PhysicsSpec(sampling=sampling, attenuation="icru-20keV")
    stack = project(block, SMALL, physics)
    assert stack.data.shape == (3, 100, 60)
    assert stack.open_field == 60000.0
    mu = attenuation_table("icru-20keV")
    for view in range(3):
        integrals = line_integrals(block, stack.geometry, view, mu, sampling=sampling)
        exact = 60000.0 * np.exp(-integrals.astype(np.float64))
        assert np.abs(stack.data[view] - exact).max() <= 0.5 + 1e-6
    assert stack.report["min_pixel_value"] == stack.data.min()
    assert stack.report["max_line_integral"] == pytest.approx(-np.log(stack.data.min() / 60000.0), rel=1e-3)
    assert stack.report["mu_per_mm"]["adipose"] == mu[Tissue.ADIPOSE]
    assert stack.report["rays"] == 18000
    assert not stack.report["truncated"]


def test_shadow_bounds_match_the_image(block):
    for acquisition in (SMALL, SMALL.with_(detector_range_degrees=8.0)):
        stack = project(block, acquisition, PhysicsSpec())
        dark = stack.data < 60000
        rows = np.flatnonzero(dark.any(axis=(0, 2)))
        columns = np.flatnonzero(dark.any(axis=(0, 1)))
        y, x = stack.geometry.detector.y_centres(), stack.geometry.detector.x_centres()
        shadow = stack.report["shadow_mm"]
        assert y[rows[0]] - 1.5 <= shadow["y_min"] <= y[rows[0]]
        assert y[rows[-1]] <= shadow["y_max"] <= y[rows[-1]] + 1.5
        assert x[columns[-1]] <= shadow["x_max"] <= x[columns[-1]] + 1.5


def test_truncation_is_refused_or_reported(block):
    narrow = SMALL.with_(detector=DetectorSpec(pixels_y=60, pixels_x=60, pixel_mm=1.5))
    with pytest.raises(GeometryError, match="along the tube travel") as caught:
        project(block, narrow, PhysicsSpec())
    assert caught.value.code == "truncated"
    short = SMALL.with_(detector=DetectorSpec(pixels_y=100, pixels_x=30, pixel_mm=1.5))
    with pytest.raises(GeometryError, match="towards the nipple") as along_x:
        project(block, short, PhysicsSpec())
    # A smaller angle helps along the tube travel alone.
    assert "a smaller angular_range_degrees" in str(caught.value)
    assert "angular_range_degrees" not in str(along_x.value)
    stack = project(block, narrow.with_(truncation="allow"), PhysicsSpec())
    assert stack.report["truncated"]
    # What is seen of the breast is the same as on the larger detector.
    whole = project(block, SMALL, PhysicsSpec())
    assert np.array_equal(stack.data, whole.data[:, 20:80])


def test_air_gap_magnifies(block):
    central = SMALL.with_(views=1)
    for gap in (0.0, 60.0):
        stack = project(block, central.with_(air_gap_mm=gap), PhysicsSpec())
        magnification = 660.0 / (660.0 - gap - 40.0)
        assert stack.report["shadow_mm"]["x_max"] == pytest.approx(50.0 * magnification, abs=1e-3)
        assert stack.report["shadow_mm"]["y_max"] == pytest.approx(40.0 * magnification, abs=1e-3)


def test_source_inside_the_phantom_is_refused():
    tall = Phantom(np.ones((100, 4, 4), np.uint8), Grid((100, 4, 4), (5.0, 5.0, 5.0), (0.0, -10.0, 0.0)))
    with pytest.raises(GeometryError, match=r"not above the top of the phantom at 520\.0 mm"):
        project(tall, SMALL.with_(source_to_detector_mm=500.0), PhysicsSpec())


def test_detector_that_would_rise_into_the_breast_is_refused(block):
    tilted = SMALL.with_(detector_range_degrees=30.0, air_gap_mm=10.0)
    with pytest.raises(GeometryError, match=r"take air_gap_mm = (\d+\.\d) or a smaller detector_range") as caught:
        project(block, tilted, PhysicsSpec())
    advised = float(re.findall(r"air_gap_mm = ([\d.]+)", str(caught.value))[0])
    project(block, tilted.with_(air_gap_mm=advised), PhysicsSpec())


def test_open_field_must_fit(block):
    detector = SMALL.detector.with_(bits=12)
    with pytest.raises(GeometryError, match="4095"):
        project(block, SMALL.with_(detector=detector), PhysicsSpec())


def test_empty_phantom_is_the_open_field():
    empty = Phantom(np.zeros((4, 4, 4), np.uint8), Grid((4, 4, 4), (5.0, 5.0, 5.0), (0.0, -10.0, 0.0)))
    stack = project(empty, SMALL, PhysicsSpec())
    assert (stack.data == 60000).all()
    assert stack.report["shadow_mm"] is None


def test_progress_and_cancel(block):
    seen = []
    project(block, SMALL, PhysicsSpec(), lambda fraction, message: seen.append(fraction))
    assert seen == sorted(seen)
    assert seen[-1] == 1.0

    def cancel(fraction, message):
        raise Cancelled("stop")

    with pytest.raises(Cancelled):
        project(block, SMALL, PhysicsSpec(), cancel)


@pytest.mark.parametrize("count", [1, 2, 3, 10, 144, 2304])
def test_spread_is_a_permutation(count):
    assert sorted(spread(count)) == list(range(count))
