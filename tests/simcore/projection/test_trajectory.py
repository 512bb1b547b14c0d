"""Listed focal spots and detector poses: the same images as any other way to the same poses, brute force, refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pydantic import ValidationError

from bench.support.siddon import siddon
from simcore import estimate, presets
from simcore.core.artifacts import Phantom
from simcore.core.errors import GeometryError, SpecError
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.tissues import Tissue
from simcore.mesh.spec import LatticeMesh
from simcore.projection import geometry_of, project
from simcore.projection.integrals import line_integrals
from simcore.projection.materials import attenuation_table
from simcore.projection.plane_prefix import serves
from simcore.projection.spec import AcquisitionSpec, DetectorPoseSpec, DetectorSpec, PhysicsSpec, SlabSpec, ViewSpec
from simcore.reconstruction import reconstruct
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import volume_grid
from simcore.reconstruction.grids import breast_grid
from simcore.reconstruction.operators.crossings import backproject, project_slices
from simcore.reconstruction.spec import Backprojection, FilteredBackprojection, Sart
from simcore.spec import SimulationSpec

MU = attenuation_table("johns-yaffe-20keV")
DETECTOR = DetectorSpec(pixels_y=100, pixels_x=60, pixel_mm=1.5)
ARC = AcquisitionSpec(views=3, detector=DETECTOR, truncation="allow")


def turned(x=0.0, y=0.0, z=0.0, origin=(0.0, 0.0, 0.0)) -> DetectorPoseSpec:
    """A pose turned by angles about the three axes, degrees, one after the other."""
    matrix = np.eye(3)
    for axis, degrees in enumerate((x, y, z)):
        c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
        step = np.eye(3)
        first, second = (axis + 1) % 3, (axis + 2) % 3
        step[[first, first, second, second], [first, second, first, second]] = c, -s, s, c
        matrix = step @ matrix
    return DetectorPoseSpec(
        origin_mm=list(origin), row_direction=matrix[:, 1].tolist(), column_direction=matrix[:, 0].tolist()
    )


def listed(*views: tuple[list[float], DetectorPoseSpec | None], **changes) -> AcquisitionSpec:
    trajectory = [ViewSpec(source_mm=source, detector=pose) for source, pose in views]
    return AcquisitionSpec(trajectory=trajectory, **{"detector": DETECTOR, "truncation": "allow", **changes})


@pytest.fixture(scope="module")
def block() -> Phantom:
    labels = np.random.default_rng(2).integers(1, 4, (20, 40, 30)).astype(np.uint8)
    labels[:, :, 25:] = 0
    return Phantom(labels, Grid(labels.shape, (2.0, 2.0, 2.0), (0.0, -40.0, 0.0)))


def test_an_arc_that_is_listed_gives_the_same_bytes(block):
    arc = geometry_of(ARC)
    same = listed(*((source.tolist(), None) for source in arc.sources))
    assert (same.views, same.angular_range_degrees, same.source_to_detector_mm) == (3, pytest.approx(40.0), 660.0)
    geometry = geometry_of(same)
    assert geometry.angles == pytest.approx(arc.angles)
    assert geometry.stationary
    assert np.array_equal(project(block, same, PhysicsSpec()).data, project(block, ARC, PhysicsSpec()).data)


def test_a_turning_detector_that_is_listed_gives_the_same_image(block):
    arc = geometry_of(ARC.with_(detector_range_degrees=8.0))
    poses = []
    for view in range(3):
        origin, rows = arc.detector_frame(view)
        poses.append(DetectorPoseSpec(origin_mm=origin.tolist(), row_direction=rows.tolist()))
    geometry = geometry_of(listed(*zip(arc.sources.tolist(), poses, strict=True)))
    assert geometry.detector_angles == pytest.approx(arc.detector_angles)
    for view in range(3):
        assert serves(geometry, view)
        difference = line_integrals(block, geometry, view, MU) - line_integrals(block, arc, view, MU)
        assert np.abs(difference).max() < 1e-5


@pytest.mark.parametrize("sampling", ["exact", "trilinear"])
@pytest.mark.parametrize(
    ("source", "pose", "fast"),
    [
        ([0.0, 100.0, 600.0], None, True),
        ([-40.0, 60.0, 500.0], None, True),
        ([35.0, -90.0, 550.0], None, False),
        ([0.0, 50.0, 600.0], turned(origin=(10.0, 25.0, -30.0)), True),
        ([0.0, 50.0, 600.0], turned(origin=(-10.0, 25.0, -30.0)), False),
        ([0.0, 50.0, 600.0], turned(x=5.0, origin=(3.0, 5.0, -5.0)), True),
        ([0.0, 50.0, 600.0], turned(y=7.0, origin=(0.0, 0.0, -5.0)), False),
        ([10.0, 50.0, 600.0], turned(x=-4.0, y=3.0, z=30.0, origin=(5.0, 0.0, -20.0)), False),
    ],
)
def test_any_pose_by_brute_force(block, source, pose, fast, sampling):
    geometry = geometry_of(listed((source, pose)))
    assert serves(geometry, 0) == fast
    values = line_integrals(block, geometry, 0, MU, sampling=sampling, step_voxels=0.02)
    grid = block.grid.moved(z=geometry.support_height)
    lit = np.argwhere(values > 0.5)
    assert len(lit) > 500
    chosen = lit[np.random.default_rng(1).choice(len(lit), 150)]
    exact = np.array(
        [siddon(block.labels, grid, geometry.sources[0], geometry.pixel_position(0, *p), MU) for p in chosen]
    )
    error = np.array([values[j, i] for j, i in chosen]) - exact
    if sampling == "exact":
        assert np.abs(error).max() < 2e-5
    else:
        # Interpolated samples of random voxels are another function of them; their mean is the same.
        assert abs(error.mean()) < 0.01 * exact.mean()


def test_a_detector_moved_by_whole_pixels_sees_shifted_images(block):
    source = [0.0, 60.0, 600.0]
    rest, moved = project(
        block, listed((source, None), (source, turned(origin=(7 * 1.5, -4 * 1.5, 0.0)))), PhysicsSpec()
    ).data
    assert np.array_equal(moved[4:, :-7], rest[:-4, 7:])


def test_shadow_bounds_of_any_pose(block):
    pose = turned(x=-3.0, y=5.0, z=20.0, origin=(2.0, 3.0, -12.0))
    stack = project(block, listed(([10.0, 50.0, 600.0], pose)), PhysicsSpec())
    dark = stack.data[0] < 60000
    rows, columns = np.flatnonzero(dark.any(axis=1)), np.flatnonzero(dark.any(axis=0))
    y, x = stack.geometry.detector.y_centres(), stack.geometry.detector.x_centres()
    shadow = stack.report["shadow_mm"]
    # The corner that reaches farthest along y lies beyond the chest-wall edge of the turned detector.
    assert y[rows[0]] - 3.0 <= shadow["y_min"] <= y[rows[0]]
    assert y[rows[-1]] <= shadow["y_max"] <= y[rows[-1]] + 3.0
    assert x[columns[-1]] <= shadow["x_max"] <= x[columns[-1]] + 1.5


def test_plates_and_rays_per_pixel_serve_any_pose(block):
    pose = turned(x=-3.0, y=5.0, z=20.0, origin=(2.0, 3.0, -12.0))
    acquisition = listed(([10.0, 50.0, 600.0], pose), paddle=SlabSpec())
    stack = project(block, acquisition, PhysicsSpec(rays_per_pixel_edge=2))
    geometry, grid = stack.geometry, block.grid.moved(z=20.0)
    for j, i in [(50, 10), (30, 20), (60, 3)]:
        signal = []
        for dj in (-0.25, 0.25):
            for di in (-0.25, 0.25):
                end = geometry.pixel_position(0, j + dj, i + di)
                ray = geometry.sources[0] - end
                plate = 2.5 * 0.0680 * np.linalg.norm(ray) / ray[2]
                signal.append(np.exp(-siddon(block.labels, grid, geometry.sources[0], end, MU) - plate))
        assert stack.data[0, j, i] == pytest.approx(60000 * np.mean(signal), abs=0.6)


def test_geometry_survives_json(block):
    acquisition = listed(
        ([0.0, 50.0, 600.0], turned(y=7.0, z=3.0, origin=(0.0, 2.0, -15.0))), ([5.0, 0.0, 640.0], None)
    )
    geometry = geometry_of(acquisition)
    again = AcquisitionGeometry.from_dict(json.loads(json.dumps(geometry.to_dict())))
    assert np.array_equal(again.detector_poses, geometry.detector_poses)
    assert not again.at_rest(0)
    assert again.at_rest(1)
    assert np.array_equal(again.pixel_position(0, 3, 4), geometry.pixel_position(0, 3, 4))
    view = geometry.to_dict()["views"][0]
    assert np.allclose(
        np.array(view["first_pixel_centre"]) + 3 * np.array(view["row_step"]) + 4 * np.array(view["column_step"]),
        geometry.pixel_position(0, 3, 4),
    )


BALL = (10.0, -5.0, 45.0)


def ball() -> Phantom:
    labels = np.zeros((20, 40, 30), np.uint8)
    centres = np.meshgrid(
        (np.arange(20) + 0.5) * 2, (np.arange(40) + 0.5) * 2 - 40, (np.arange(30) + 0.5) * 2, indexing="ij"
    )
    distance2 = (centres[2] - BALL[0]) ** 2 + (centres[1] - BALL[1]) ** 2 + (centres[0] + 20 - BALL[2]) ** 2
    labels[distance2 < 6.0**2] = Tissue.CALCIFICATION
    return Phantom(labels, Grid(labels.shape, (2.0, 2.0, 2.0), (0.0, -40.0, 0.0)))


def brightest(volume):
    _, j, i = np.unravel_index(np.argmax(volume.data), volume.data.shape)
    weights = volume.data[:, j - 4 : j + 5, i - 4 : i + 5] - volume.data.min()
    at = np.meshgrid(volume.grid.centres("z"), volume.grid.centres("y")[j - 4 : j + 5],
                     volume.grid.centres("x")[i - 4 : i + 5], indexing="ij")  # fmt: skip
    return [float(np.average(at[axis], weights=weights**4.0)) for axis in (2, 1, 0)]


@pytest.mark.parametrize("spec", [Backprojection(), FilteredBackprojection(), Sart(iterations=2)], ids=lambda s: s.kind)
def test_a_ball_is_found_where_it_is_from_any_detector_pose(spec):
    arc = geometry_of(ARC.with_(views=9))
    poses = [turned(x=3.0 - view, y=3.0, z=2.0 * view - 8.0, origin=(-4.0, 2.0, -12.0)) for view in range(9)]
    stack = project(ball(), listed(*zip(arc.sources.tolist(), poses, strict=True)), PhysicsSpec())
    volume = reconstruct(stack, spec.with_(slice_mm=2.0, pixel_mm=1.5), 40.0)
    x, y, z = brightest(volume)
    assert abs(x - BALL[0]) < 0.8
    assert abs(y - BALL[1]) < 0.8
    assert abs(z - BALL[2]) < 3.0


def test_the_box_of_the_breast_is_the_same_from_detectors_far_below():
    arc = geometry_of(ARC)
    low = [turned(y=2.0, z=5.0, origin=(-9.0, 0.0, -120.0)) for _ in range(3)]
    wide = {"detector": DETECTOR.with_(pixels_y=160, pixels_x=90)}
    boxes = []
    for poses in ([None] * 3, low):
        stack = project(ball(), listed(*zip(arc.sources.tolist(), poses, strict=True), **wide), PhysicsSpec())
        boxes.append(breast_grid(stack, volume_grid(stack.geometry, FilteredBackprojection(slice_mm=2.0), Body(40.0))))
    for grid in boxes:
        assert grid.corner[1] < BALL[1] - 6.0 < BALL[1] + 6.0 < grid.upper[1]
        assert BALL[0] + 6.0 < grid.upper[0]
    # The turned detectors see the box of a turned rectangle.
    assert np.abs(np.array(boxes[0].upper) - boxes[1].upper).max() < 6.0
    assert np.abs(np.array(boxes[0].corner) - boxes[1].corner).max() < 6.0


def test_a_source_beside_the_chest_wall_plane_needs_an_iterative_reconstruction():
    sources = [[25.0 * np.sin(a), 150.0 * np.cos(a), 600.0] for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
    stack = project(ball(), listed(*((source, None) for source in sources)), PhysicsSpec())
    for spec in (FilteredBackprojection(), Backprojection()):
        with pytest.raises(GeometryError, match="an iterative reconstruction takes any trajectory"):
            reconstruct(stack, spec, 40.0)
    x, y, z = brightest(reconstruct(stack, Sart(slice_mm=2.0, pixel_mm=1.5, iterations=2), 40.0))
    assert (abs(x - BALL[0]) < 0.8, abs(y - BALL[1]) < 0.8, abs(z - BALL[2]) < 3.0) == (True, True, True)


def test_the_operator_pair_is_adjoint_for_sources_anywhere():
    """What iterative reconstructions use, with sources on both sides of the chest wall's plane."""
    rng = np.random.default_rng(0)
    sources = [[-30.0, 10.0, 400.0], [25.0, -60.0, 380.0], [0.0, 80.0, 420.0], [60.0, 0.0, 400.0]]
    detector = DetectorSpec(pixels_y=50, pixels_x=40, pixel_mm=1.3)
    geometry = geometry_of(listed(*((source, None) for source in sources), detector=detector))
    grid = Grid((9, 33, 27), (1.1, 1.1, 2.0), (0.0, -18.0, 20.0))
    x, y = rng.random(grid.shape).astype(np.float32), rng.random((4, 50, 40)).astype(np.float32)
    forward = np.vdot(project_slices(x, grid, geometry).astype(np.float64), y)
    assert forward == pytest.approx(np.vdot(x, backproject(y, grid, geometry).astype(np.float64)), rel=1e-6)


@pytest.mark.parametrize(
    ("source", "pose", "said"),
    [
        ([0.0, 0.0, 40.0], None, "40.0 mm above the detector, not above the top of the phantom at 60.0 mm"),
        ([0.0, 0.0, 600.0], turned(x=90.0, origin=(0.0, 0.0, -80.0)), "in the plane of the detector"),
        ([0.0, 0.0, 600.0], turned(x=180.0, origin=(0.0, 0.0, -10.0)), r"610\.0 mm behind the detector"),
        ([0.0, 0.0, 600.0], turned(origin=(0.0, 0.0, 30.0)), "rises to 30.00 mm, above the bottom of the phantom"),
        ([0.0, 0.0, 600.0], turned(y=-20.0), "rises to 30.78 mm"),
    ],
)
def test_poses_that_cannot_be_served(block, source, pose, said):
    acquisition = listed(([0.0, 0.0, 600.0], None), (source, pose))
    with pytest.raises(GeometryError, match=f"^view 1 .*{said}|^view 1: .*{said}"):
        project(block, acquisition, PhysicsSpec())


def posed(row_direction):
    return {"source_mm": [0, 0, 600], "detector": {"origin_mm": [0, 0, 0], "row_direction": row_direction}}


@pytest.mark.parametrize(
    ("trajectory", "said"),
    [
        ([], "at least 1 item"),
        ([{"source_mm": [0, 0]}], r"trajectory\.0\.source_mm: .* at least 3"),
        ([{"source_mm": [0, 0, "600"]}], r"trajectory\.0\.source_mm\.2 = '600'"),
        ([{"source": [0, 0, 600]}], r"trajectory\.0\.source: unknown field"),
        ([{"source_mm": [0, 0, 100]}], r"source_to_detector_mm = 100"),
        ([{"source_mm": [0, 0, 600]}, {"source_mm": [0, 5, -20]}], r"trajectory\.1.*: z = -20 mm"),
        ([posed([0, 2, 0])], "length 2"),
        ([posed([1, 0, 0])], "perpendicular"),
    ],
)  # fmt: skip
def test_lists_that_are_no_trajectory(trajectory, said):
    with pytest.raises(SpecError, match=said):
        SimulationSpec.from_dict({"acquisition": {"trajectory": trajectory}})


@pytest.mark.parametrize(
    ("field", "value"),
    [("views", 3), ("angular_range_degrees", 10.0), ("source_to_detector_mm", 700.0), ("detector_range_degrees", 4.0)],
)
def test_what_follows_from_a_trajectory_cannot_be_asked_otherwise(field, value):
    with pytest.raises(ValidationError, match=f"{field} = {value:g}"):
        listed(([0.0, 0.0, 600.0], None), ([0.0, 10.0, 600.0], None), **{field: value})


def case(*views, **changes) -> SimulationSpec:
    return presets.get("tiny").with_(
        mesh=LatticeMesh(edge_length_mm=16.0),
        acquisition=listed(*views, detector=presets.get("tiny").acquisition.detector),
        **changes,
    )


def test_estimates_know_trajectories():
    plain = [([0.0, y, 600.0], None) for y in (-100.0, 0.0, 100.0)]
    estimate.check(case(*plain))
    with pytest.raises(
        SpecError, match=r"trajectory\.1\.source_mm = \[30\.0, 0\.0, 600\.0\]: reconstruction\.kind = 'fbp' needs"
    ):
        estimate.check(case(plain[0], ([30.0, 0.0, 600.0], None)))
    estimate.check(case(plain[0], ([30.0, 0.0, 600.0], None), reconstruction=Sart(slice_mm=2.0)))
    with pytest.raises(SpecError, match="not above the top of the phantom"):
        estimate.check(case(plain[1], ([0.0, 200.0, 50.0], None)))
    narrow = case(*plain)
    narrow = narrow.with_(
        acquisition=narrow.acquisition.with_(truncation="refuse", detector=DETECTOR.with_(pixels_x=20))
    )
    with pytest.raises(SpecError, match=r"pixels_x = 20: the breast reaches"):
        estimate.check(narrow)


def test_estimates_know_what_rays_cost():
    spec = presets.get("ge-senographe-ds")

    def needs(**physics):
        return estimate.estimate(spec.with_(physics=PhysicsSpec(**physics)))

    plain, four, sampled = needs(), needs(rays_per_pixel_edge=2), needs(sampling="trilinear")
    assert four.memory_bytes - plain.memory_bytes == 3 * 4 * 2304 * 1920
    assert four.seconds - plain.seconds == pytest.approx(3 * 15 * 2304 * 1920 * 1e-8, abs=0.2)
    assert sampled.seconds > plain.seconds + 50
    assert needs(sampling="trilinear", step_voxels=0.1).seconds > sampled.seconds + 150
    moved = [
        ViewSpec(source_mm=[0.0, y, 600.0], detector=turned(y=1.0, origin=(0.0, 0.0, -9.0))) for y in (-50.0, 50.0)
    ]
    posed_case = spec.with_(acquisition=AcquisitionSpec(trajectory=moved))
    rest = [view.with_(detector=None) for view in moved]
    assert (
        estimate.estimate(posed_case).seconds
        > estimate.estimate(spec.with_(acquisition=AcquisitionSpec(trajectory=rest))).seconds + 2
    )
