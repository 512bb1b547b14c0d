"""A chest wall that keeps its height: the body reaches beyond the plates, and all that follows holds it whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simcore import estimate, fem, mesh, phantom, presets, projection, warp
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, TetMesh
from simcore.core.errors import GeometryError, SolverError, SpecError
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.dicom.lesions import find_lesions
from simcore.fem.spec import CompressionSpec
from simcore.mesh.spec import LatticeMesh
from simcore.mesh.structured import box
from simcore.projection.spec import AcquisitionSpec, DetectorSpec, PhysicsSpec
from simcore.reconstruction import FilteredBackprojection, reconstruct
from simcore.reconstruction.kinds.backprojection import Backprojection
from simcore.reconstruction.kinds.sirt import Sirt

TINY = presets.get("tiny")
ACQUISITION = AcquisitionSpec(
    views=5,
    angular_range_degrees=30.0,
    air_gap_mm=20.0,
    detector=DetectorSpec(pixels_x=100, pixels_y=140, pixel_mm=1.0),
)


@pytest.fixture(scope="module")
def breast() -> Phantom:
    return phantom.generate(TINY.phantom, 1)


@pytest.fixture(scope="module")
def tets(breast: Phantom) -> TetMesh:
    return mesh.build(breast, LatticeMesh(edge_length_mm=12.0))


@pytest.fixture(scope="module")
def fixed(breast: Phantom, tets: TetMesh) -> Compression:
    return fem.compress(tets, breast, CompressionSpec(percent=50.0, chest_wall="fixed"))


@pytest.fixture(scope="module")
def warped(breast: Phantom, tets: TetMesh, fixed: Compression) -> Phantom:
    return warp.deform(breast, tets, fixed, warp.WarpSpec())


@pytest.fixture(scope="module")
def stack(warped: Phantom) -> ProjectionStack:
    return projection.project(warped, ACQUISITION, PhysicsSpec())


def test_nothing_is_cut_at_the_plates(breast: Phantom, warped: Phantom, fixed: Compression) -> None:
    """It was 44 ml of 60."""
    report = warped.report
    assert report["volume_after_ml"] == pytest.approx(report["volume_before_ml"], rel=0.01)
    assert report["volume_after_ml"] == pytest.approx(report["mesh_volume_ml"], rel=0.005)
    for name, ml in report["tissue_expected_ml"].items():
        assert report["tissue_after_ml"][name] == pytest.approx(ml, rel=0.02)
    below, above = report["beyond_plates_mm"]
    travel = (breast.report["semi_axes_mm"][2] + breast.report["semi_axes_mm"][3] - fixed.thickness) / 2
    assert below == pytest.approx(travel, abs=1.0)
    assert above == pytest.approx(travel, abs=1.0)
    # The whole wall is there, and no empty layer above or below.
    assert warped.labels[:, :, 0].any(axis=1).sum() == pytest.approx(breast.labels[:, :, 0].any(axis=1).sum(), abs=1)
    assert warped.labels[0].any()
    assert warped.labels[-1].any()
    # The support frame is as it was: z = 0 is a face between voxels.
    assert warped.grid.corner == (0.0, -warped.grid.shape[1] / 2, -below)


def test_a_free_wall_has_its_grid_from_plate_to_plate(breast: Phantom, tets: TetMesh) -> None:
    free = fem.compress(tets, breast, CompressionSpec(percent=50.0))
    out = warp.deform(breast, tets, free, warp.WarpSpec())
    assert out.report["beyond_plates_mm"] == [0.0, 0.0]
    assert out.grid.corner[2] == 0.0
    assert out.grid.shape[0] == np.ceil(free.thickness)


def test_the_flat_part_keeps_to_the_plates(warped: Phantom, fixed: Compression) -> None:
    """Where plates are flat, 40 mm from the undeformed wall, there is tissue between them alone."""
    z = warped.grid.centres("z")
    x = warped.grid.centres("x")
    beyond = (z < 0) | (z > fixed.thickness)
    assert not warped.labels[np.ix_(beyond, np.ones(warped.grid.shape[1], bool), x > 36.0)].any()


@pytest.mark.parametrize("sampling", ["exact", "trilinear"])
def test_projection_sees_what_lies_below_the_support(warped: Phantom, sampling: str) -> None:
    """The same voxels from another z = 0 are the same scene."""
    below = warped.report["beyond_plates_mm"][0]
    lifted = replace(warped, grid=warped.grid.moved(z=below))
    physics = PhysicsSpec(sampling=sampling)
    one = projection.project(warped, ACQUISITION, physics)
    other = projection.project(lifted, ACQUISITION.with_(air_gap_mm=ACQUISITION.air_gap_mm - below), physics)
    assert np.abs(one.data.astype(int) - other.data).max() <= 1
    assert one.report["shadow_mm"] == other.report["shadow_mm"]


@pytest.mark.parametrize(
    "spec", [FilteredBackprojection(slice_mm=2.0), Backprojection(slice_mm=2.0), Sirt(slice_mm=2.0, iterations=2)]
)
def test_volumes_hold_the_whole_body(
    warped: Phantom, fixed: Compression, stack: ProjectionStack, spec: FilteredBackprojection
) -> None:
    below, above = warped.report["beyond_plates_mm"]
    volume = reconstruct(stack, spec, fixed.thickness, beyond_mm=(below, above))
    lift = stack.geometry.support_height
    assert volume.grid.corner[2] <= warped.grid.corner[2] + lift
    assert volume.grid.upper[2] >= warped.grid.upper[2] + lift
    # Slices between the plates are those of a volume from plate to plate.
    plain = reconstruct(stack, spec, fixed.thickness)
    assert plain.grid.corner[2] == lift
    assert (lift - volume.grid.corner[2]) % 2.0 == pytest.approx(0.0)
    if spec.kind != "sirt":
        first = round((lift - volume.grid.corner[2]) / 2.0)
        same = volume.data[first : first + 3, :, : plain.grid.shape[2]].astype(int) - plain.data[:3]
        assert np.abs(same).max() <= 0.02 * plain.data.max()


def test_no_slice_lies_below_the_detector(fixed: Compression, stack: ProjectionStack) -> None:
    volume = reconstruct(stack, FilteredBackprojection(slice_mm=3.0), fixed.thickness, beyond_mm=(19.9, 0.0))
    assert volume.grid.corner[2] == pytest.approx(20.0 - 6 * 3.0)


def test_a_lesion_above_the_paddle_has_its_box(breast: Phantom, tets: TetMesh, fixed: Compression) -> None:
    labels = breast.labels.copy()
    z, y, x = np.meshgrid(*(breast.grid.centres(axis) for axis in "zyx"), indexing="ij")
    labels[(z - 20.0) ** 2 + y**2 + (x - 5.0) ** 2 < 9.0] = Tissue.MASS
    truth = {"id": "mass-1", "kind": "mass", "tissue": "mass", "centre_mm": [5.0, 0.0, 20.0]}
    out = warp.deform(Phantom(labels, breast.grid, (truth,)), tets, fixed, warp.WarpSpec())
    assert out.truth[0]["centre_mm"][2] > fixed.thickness
    stack = projection.project(out, ACQUISITION, PhysicsSpec())
    volume = reconstruct(
        stack, FilteredBackprojection(), fixed.thickness, beyond_mm=tuple(out.report["beyond_plates_mm"])
    )
    (lesion,) = find_lesions(out, stack.geometry.support_height, volume.grid)
    assert len(lesion.voxels) > 50
    assert lesion.first[0] * 1.0 + volume.grid.corner[2] > stack.geometry.support_height + fixed.thickness


def test_a_body_that_hangs_into_the_detector_is_refused_and_the_advice_suffices(warped: Phantom) -> None:
    low = ACQUISITION.with_(air_gap_mm=5.0)
    with pytest.raises(GeometryError, match=r"above the bottom of the phantom at -8\.00 mm; take air_gap_mm = 13$"):
        projection.project(warped, low, PhysicsSpec())
    projection.project(warped, low.with_(air_gap_mm=13.0), PhysicsSpec())


def test_the_estimate_refuses_it_before_anything_runs() -> None:
    spec = TINY.with_(
        compression=CompressionSpec(percent=50.0, chest_wall="fixed"),
        acquisition=TINY.acquisition.with_(air_gap_mm=5.0),
    )
    with pytest.raises(SpecError, match=r"acquisition.air_gap_mm = 5: .* 13\.3 mm below .*: at least 15") as caught:
        estimate.check(spec)
    assert caught.value.problems[0]["field"] == "acquisition.air_gap_mm"
    needs = estimate.check(spec.with_(acquisition=spec.acquisition.with_(air_gap_mm=15.0)))
    free = spec.with_(compression=CompressionSpec(percent=50.0))
    estimate.check(free)
    # Slices for what lies beyond: 27 mm more of 2 mm, 160 x 256 pixels of 2 bytes.
    assert needs.output_bytes > estimate.estimate(free).output_bytes + 13 * 160 * 256 * 2


def test_tissue_that_is_missing_is_an_error(breast: Phantom, tets: TetMesh, fixed: Compression) -> None:
    """A mesh without the upper part of the breast: as if the grid had cut it."""
    high = tets.nodes[tets.tets][:, :, 2].mean(axis=1) > 12.0
    part = TetMesh(tets.nodes, tets.tets[~high], tets.wall, np.empty((0, 3), np.int64))
    with pytest.raises(SolverError, match=r"has \d.* ml after compression where .* belong there.*; take ") as caught:
        warp.deform(breast, part, fixed, warp.WarpSpec())
    assert caught.value.code == "tissue-lost"
    assert "skirt_mm above 1.5" in str(caught.value)
    with pytest.raises(SolverError) as widest:
        warp.deform(breast, part, fixed, warp.WarpSpec(skirt_mm=5.0))
    assert "skirt_mm" not in str(widest.value)


def test_a_body_behind_the_wall_is_held_too() -> None:
    """The rim of a wall may bulge: nodes at x < 0."""
    cube = box((10.0, 10.0, 10.0), (2, 2, 2))
    low = cube.nodes.min(axis=0)
    nodes = cube.nodes - [0.0, low[1] + 5.0, low[2] + 5.0]
    tets = TetMesh(nodes, cube.tets, cube.wall, cube.skin)
    labels = np.ones((20, 20, 20), np.uint8)
    body = Phantom(labels, Grid(labels.shape, (0.5,) * 3, (0.0, -5.0, -5.0)))
    displacement = np.zeros_like(nodes)
    displacement[:, 0] = -2.0
    out = warp.deform(body, tets, Compression(displacement, (-5.0, 5.0), 1.0, "converged"), warp.WarpSpec())
    assert out.report["volume_after_ml"] == pytest.approx(1.0, rel=0.01)
    assert out.grid.corner[0] <= -2.0
    filled = np.flatnonzero(out.labels.any(axis=(0, 1)))
    assert out.grid.centres("x")[filled[[0, -1]]].tolist() == [-1.75, 7.75]
