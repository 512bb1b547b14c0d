"""Breast support and paddle: exact path lengths, and reconstructions that do not see them."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from simcore.core.artifacts import Phantom
from simcore.core.errors import GeometryError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.projection import project
from simcore.projection.materials import attenuation_table
from simcore.projection.slabs import material_table, upright_integral
from simcore.projection.spec import AcquisitionSpec, DetectorSpec, PhysicsSpec, SlabSpec
from simcore.reconstruction import reconstruct
from simcore.reconstruction.spec import FilteredBackprojection, Sart

PADDLE = SlabSpec(thickness_mm=2.5)
SUPPORT = SlabSpec(material="carbon-fibre", thickness_mm=1.2)
SMALL = AcquisitionSpec(views=5, truncation="allow", detector=DetectorSpec(pixels_y=100, pixels_x=60, pixel_mm=1.5))


def block_of(tissue: int) -> Phantom:
    labels = np.full((20, 40, 30), tissue, np.uint8)
    return Phantom(labels, Grid(labels.shape, (2.0, 2.0, 2.0), (0.0, -40.0, 0.0)))


def lengths_per_height(geometry, view):
    """Length of the ray to each pixel per mm that it falls, from the pixels' positions one by one."""
    detector = geometry.detector
    pixels = np.array([[geometry.pixel_position(view, j, i) for i in range(detector.nx)] for j in range(detector.ny)])
    rays = pixels - geometry.sources[view]
    return np.linalg.norm(rays, axis=-1) / -rays[..., 2]


@pytest.mark.parametrize("turn", [0.0, 8.0])
def test_plates_alone(turn):
    acquisition = SMALL.with_(paddle=PADDLE, support=SUPPORT, detector_range_degrees=turn)
    stack = project(block_of(Tissue.AIR), acquisition, PhysicsSpec())
    mu_t = 2.5 * 0.0680 + 1.2 * 0.0707
    assert stack.slab_integral == pytest.approx(mu_t)
    assert stack.report["slab_integral"] == stack.slab_integral
    for view in range(5):
        expected = 60000 * np.exp(-mu_t * lengths_per_height(stack.geometry, view))
        assert np.abs(stack.data[view] - expected).max() < 0.51
    assert stack.background == pytest.approx(60000 * np.exp(-mu_t))


def test_plates_multiply_what_the_breast_lets_through():
    breast = block_of(Tissue.GLAND)
    bare = project(breast, SMALL, PhysicsSpec(rays_per_pixel_edge=2))
    behind = project(breast, SMALL.with_(paddle=PADDLE), PhysicsSpec(rays_per_pixel_edge=2))
    for view in range(5):
        factor = np.exp(-2.5 * 0.0680 * lengths_per_height(bare.geometry, view))
        assert np.abs(behind.data[view] - bare.data[view] * factor).max() < 1.5
    assert bare.slab_integral == 0.0
    assert "slab_integral" not in bare.report


@pytest.mark.parametrize("turn", [0.0, 8.0])
@pytest.mark.parametrize(
    "spec", [FilteredBackprojection(slice_mm=4.0), Sart(slice_mm=4.0, field="breast", iterations=1)]
)
def test_a_reconstruction_does_not_see_them(turn, spec):
    breast = block_of(Tissue.ADIPOSE)
    acquisition = SMALL.with_(detector_range_degrees=turn)
    bare = reconstruct(project(breast, acquisition, PhysicsSpec()), spec, 40.0)
    behind = reconstruct(project(breast, acquisition.with_(paddle=PADDLE, support=SUPPORT), PhysicsSpec()), spec, 40.0)
    assert behind.grid == bare.grid
    difference = bare.slope * np.abs(bare.data.astype(np.int64) - behind.data)
    # Rounding of darker pixels, and at the edge of a turned detector interpolation.
    assert np.quantile(difference, 0.999) < 1e-3 * 0.0456 * 5
    assert difference.mean() < 1e-4


def test_coefficients():
    table = material_table()
    assert table["pmma"] == 0.0680
    assert set(table) | {"other"} == set(SlabSpec.model_fields["material"].annotation.__args__)
    own = SlabSpec(material="other", attenuation_per_mm=0.3, thickness_mm=2.0)
    assert upright_integral([own, PADDLE]) == pytest.approx(0.6 + 0.17)
    assert upright_integral([]) == 0.0


@pytest.mark.parametrize("wrong", [{"material": "other"}, {"attenuation_per_mm": 0.1}])
def test_a_coefficient_belongs_to_another_material(wrong):
    with pytest.raises(ValidationError, match="needs attenuation_per_mm"):
        SlabSpec(**wrong)


def test_the_support_must_fit_and_the_paddle_lie_below_the_source():
    with pytest.raises(ValidationError, match=r"support\.thickness_mm = 30 does not fit"):
        SMALL.with_(support=SlabSpec(thickness_mm=30.0))
    near = SMALL.with_(source_to_detector_mm=200.0, air_gap_mm=130.0, views=1)
    project(block_of(Tissue.GLAND), near, PhysicsSpec())
    with pytest.raises(GeometryError, match=r"top of the phantom at 210\.0 mm"):
        project(block_of(Tissue.GLAND), near.with_(paddle=SlabSpec(thickness_mm=40.0)), PhysicsSpec())


def test_nothing_is_written_of_plates_that_are_not_there():
    assert "paddle" not in SMALL.parameters()
    assert "rays_per_pixel_edge" not in PhysicsSpec().parameters()
    assert PhysicsSpec(rays_per_pixel_edge=2).parameters()["rays_per_pixel_edge"] == 2
    assert SMALL.with_(paddle=PADDLE).parameters()["paddle"] == {"material": "pmma", "thickness_mm": 2.5}
    assert attenuation_table("johns-yaffe-20keV")[Tissue.AIR] == 0.0
