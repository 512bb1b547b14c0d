"""What a case will need, before anything runs; and whether it may run at all."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from simcore import available, unused
from simcore.capacity import SHADOW_MARGIN, beyond_plates, check_objects, predicted_grid
from simcore.core.errors import GeometryError, ResourceLimitError, SpecError
from simcore.core.memory import physical_bytes
from simcore.core.tissues import Tissue
from simcore.needs import Estimate
from simcore.pipeline.graph import Sizes
from simcore.pipeline.table import TABLE
from simcore.pipeline.xray import optics_of
from simcore.projection.acquisition import geometry_of
from simcore.projection.poses import check_poses
from simcore.projection.spec import AcquisitionSpec
from simcore.spec import SimulationSpec

# How much deeper (x) and wider (y) a breast gets between the plates, against the compressed fraction of its thickness:
# the solver's own results for the default outline and material, which hold for every volume. docs/stages.md.
GROWTH_FRACTION = (0.0, 0.2, 0.5, 0.7, 0.75)
GROWTH_X = (1.0, 1.032, 1.193, 1.47, 1.60)
GROWTH_Y = (1.0, 1.048, 1.245, 1.53, 1.65)

# What is advised holds for every law and shape: the whole breast at the height of the upper plate, and so much larger.
ADVICE_MARGIN = 1.06
MOST_PIXELS = 8192

# Reconstructions that need a tube in the plane of the chest wall.
IN_PLANE = ("fbp", "backprojection")

# Measured on the paper's case; docs/performance.md.
BYTES_BASE = 500e6
BYTES_PER_TETRAHEDRON = 6e3
# Noise-free signal and variance, those with scatter, open field, raw and flat-fielded values of a pixel of a view.
BYTES_PER_XRAY_PIXEL = 26.0
# Of a ray on two cores, by the way it is computed; samples at 0.2 mm voxels and steps of 0.45 through 96 mm.
SECONDS_PER_RAY = {"planes": 1e-8, "turned": 1.3e-7, "one by one": 5e-7, "samples": 1.4e-6}


def compressed_extent(spec: SimulationSpec) -> tuple[float, float, float]:
    """Predicted extent of the compressed breast: (depth along x, width along y, thickness along z), mm.

    Where the plates stop, turn or bend as the forces tell, which is not known before: the largest of each.
    """
    depth, half_width, upper, lower = spec.phantom.semi_axes()
    if spec.phantom.compressed:
        return depth, 2 * half_width, upper + lower
    c = spec.compression
    most = least = c.percent / 100
    if c.thickness_mm is not None:
        most = least = min(max(1 - c.thickness_mm / (upper + lower), 0.0), most)
    elif c.force_N is not None or c.spring_paddle is not None or c.elastic_plates is not None:
        least = 0.0
    grown = depth * _interpolate(most, GROWTH_X)
    # A paddle that opens towards the nipple leaves the breast its thickness there, but no more than it had.
    opening = grown * math.tan(math.radians(max(c.paddle_angle_degrees, 0.0)))
    thickness = min((upper + lower) * (1 - least) + opening, upper + lower)
    return grown, 2 * half_width * _interpolate(most, GROWTH_Y), thickness


def _interpolate(fraction: float, growth: tuple[float, ...]) -> float:
    """Between the nearest two of GROWTH_FRACTION."""
    k = min(bisect_right(GROWTH_FRACTION, fraction), len(growth) - 1)
    f0, f1 = GROWTH_FRACTION[k - 1 : k + 1]
    return growth[k - 1] + (growth[k] - growth[k - 1]) * (fraction - f0) / (f1 - f0)


def estimate(spec: SimulationSpec) -> Estimate:
    """Memory, bytes and seconds; good to some 20 %."""
    before = spec.phantom.voxels
    cx, cy, cz = compressed_extent(spec)
    height = cz + 2 * beyond_plates(spec, (cx, cy, cz))
    after = cx * cy * height / spec.phantom.voxel_volume_mm3
    a = spec.acquisition
    pixels = a.detector.pixels_x * a.detector.pixels_y
    grid = predicted_grid(spec, (cx, cy, cz))
    volume, plane = grid.size, grid.shape[1] * grid.shape[2]
    # Iterations need every voxel that the rays of a view meet, whatever region is kept of them.
    worked = predicted_grid(spec, (cx, cy, cz), whole=True).size if spec.reconstruction.is_kept else volume
    stack = pixels * a.views
    tets = 0.0 if spec.phantom.compressed else 35e3 * (5.5 / spec.mesh.edge_length_mm) ** 3
    labels = spec.phantom.voxels_held
    memory = BYTES_BASE + labels + after + BYTES_PER_TETRAHEDRON * tets + 2 * stack + 2 * worked + max(after, 4 * stack)
    rays = 1
    if spec.physics.kind == "xray":
        memory += BYTES_PER_XRAY_PIXEL * stack
    else:
        rays = spec.physics.rays_per_pixel_edge**2
        memory += 4 * pixels * (rays - 1)
    further = {
        "presentation": 2 * stack,
        "synthetic-2d": 2 * plane,
        "ct": 2 * volume,
        "attenuation": 4 * volume,
    }
    output = 4 * stack + 2 * volume + 0.02 * volume + 5e6 + sum(further.get(e, 0) for e in spec.export.extra_objects)
    sizes = Sizes(before, after, tets, stack, pixels * rays * _view_seconds(spec, height), volume, worked, output)
    needs = [stage.needs(spec, sizes) for stage in TABLE if stage.inputs(spec) is not None]
    return Estimate(
        voxels=int(before),
        memory_bytes=int(memory),
        storage_bytes=int(sum(stage.stored_bytes for stage in needs)),
        output_bytes=int(output),
        seconds=round(sum(stage.seconds for stage in needs), 1),
        remarks=unused.remarks(spec),
    )


def _view_seconds(spec: SimulationSpec, thickness: float) -> float:
    """Time of one ray in every view, summed over the views. thickness: of the breast, mm."""
    a, physics = spec.acquisition, spec.physics
    if physics.kind == "monoenergetic" and physics.sampling == "trilinear":
        samples = thickness / (physics.step_voxels * math.cbrt(spec.phantom.voxel_volume_mm3))
        return a.views * SECONDS_PER_RAY["samples"] * samples * 0.45 * 0.2 / 96.0
    if a.trajectory is None:
        return a.views * SECONDS_PER_RAY["turned" if a.detector_range_degrees else "planes"]
    one_by_one = sum(v.detector is not None or v.source_mm[0] > a.detector.pixel_mm / 2 for v in a.trajectory)
    return one_by_one * SECONDS_PER_RAY["one by one"] + (a.views - one_by_one) * SECONDS_PER_RAY["planes"]


def check(spec: SimulationSpec, memory_limit_bytes: int | None = None) -> Estimate:
    """The estimate of a specification that can be simulated.

    memory_limit_bytes: the machine's memory where not given.
    raises: SpecError where the geometry cannot work, ResourceLimitError where too much is asked; each message names
    the field, the needed and the allowed value.
    """
    unused.refuse(spec)
    available.refuse(spec)
    _check_plates(spec)
    _check_geometry(spec)
    if spec.physics.kind == "xray":
        spec.physics.exposure.shares(spec.acquisition.views)
        optics_of(spec.acquisition, spec.physics)
    limit = physical_bytes() if memory_limit_bytes is None else memory_limit_bytes
    check_objects(spec, compressed_extent(spec), lambda other: estimate(other).memory_bytes <= limit)
    needs = estimate(spec)
    if needs.memory_bytes > limit:
        raise ResourceLimitError(
            f"{spec.phantom.size_in_words} and {spec.acquisition.views} views needs "
            f"{needs.memory_bytes / 1e9:.1f} GB of memory; "
            f"{limit / 1e9:.1f} GB are allowed: use larger voxels{_voxels_that_fit(spec, limit)}, "
            "fewer views or thicker slices"
        )
    return needs


def _voxels_that_fit(spec: SimulationSpec, limit: int) -> str:
    """In brackets, the voxel edges with which a case needs no more than ``limit`` bytes; "" where none would do."""

    def fits(factor: float) -> bool:
        return estimate(spec.with_(phantom=spec.phantom.with_coarser_voxels(factor))).memory_bytes <= limit

    low, high = 1.0, spec.phantom.coarsest
    if high <= 1.0 or not fits(high):
        return ""
    while high > 1.005 * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if fits(middle) else (middle, high)
    edges = [_rounded_up(edge * high) for edge in spec.phantom.edges_mm]
    shown = edges[:1] if len(set(edges)) == 1 else edges
    return f" ({' x '.join(f'{edge:g}' for edge in shown)} mm would do)"


def _rounded_up(value: float) -> float:
    """To two digits."""
    step: float = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(round(value / step, 6)) * step


def _check_geometry(spec: SimulationSpec) -> None:
    a = spec.acquisition
    if a.views < 2:
        _refuse("acquisition.views", a.views, "a volume needs at least 2 views")
    if a.angular_range_degrees == 0:
        _refuse("acquisition.angular_range_degrees", 0.0, "a volume needs views at different angles: more than 0")
    depth, width, thickness = compressed_extent(spec)
    beyond = beyond_plates(spec, (depth, width, thickness))
    top = a.air_gap_mm + thickness + max(beyond, a.paddle_mm)
    # The stage looks at the voxels, which may be one more; an uploaded breast may be thicker than its wall is high.
    voxel = math.cbrt(spec.phantom.voxel_volume_mm3)
    if a.air_gap_mm < beyond - voxel and spec.phantom.kind == "anthropomorphic":
        _refuse(
            "acquisition.air_gap_mm",
            a.air_gap_mm,
            f"with compression.chest_wall = {spec.compression.chest_wall!r} the breast keeps its height there and "
            f"hangs {beyond:.1f} mm below the breast support: at least "
            f"{math.ceil(beyond + voxel)}, or a smaller compression",
        )
    heights = (a.air_gap_mm + thickness / 2, a.air_gap_mm + thickness)
    if a.trajectory is not None:
        _check_trajectory(spec, top)
        sources = geometry_of(a).sources
        if a.truncation == "refuse" and all(view.detector is None for view in a.trajectory):
            _check_reach_x(a, sources, depth, heights)
            _check_reach_y(a, sources, width, heights)
        return
    # The focal spot is lowest in the outermost view.
    half = math.radians(a.angular_range_degrees / 2)
    radius = a.source_to_detector_mm - a.isocenter_height_mm
    if radius <= 0:
        _refuse(
            "acquisition.isocenter_height_mm",
            a.isocenter_height_mm,
            f"the isocenter must lie below the source: less than source_to_detector_mm = {a.source_to_detector_mm:g}",
        )
    lowest = a.isocenter_height_mm + radius * math.cos(half)
    if lowest <= top + 50:
        _refuse(
            "acquisition.source_to_detector_mm",
            a.source_to_detector_mm,
            f"the focal spot comes down to {lowest:.0f} mm above the detector; the breast reaches {top:.0f} mm, and "
            f"50 mm must lie between",
        )
    if a.truncation == "refuse":
        _check_reach_x(a, np.array([[0.0, 0.0, a.source_to_detector_mm]]), depth, heights)
        _check_reach_y(a, np.array([[0.0, radius * math.sin(half), lowest]]), width, heights)


def _check_trajectory(spec: SimulationSpec, top: float) -> None:
    geometry = geometry_of(spec.acquisition)
    try:
        check_poses(geometry, spec.acquisition.air_gap_mm, top)
    except GeometryError as error:
        _refuse("acquisition.trajectory", str(len(geometry.sources)) + " views", str(error))
    beside = np.flatnonzero(np.abs(geometry.sources[:, 0]) > 1e-9)
    if len(beside) and spec.reconstruction.kind in IN_PLANE:
        _refuse(
            f"acquisition.trajectory.{beside[0]}.source_mm",
            str(geometry.sources[beside[0]].tolist()),
            f"reconstruction.kind = {spec.reconstruction.kind!r} needs a tube in the plane of the chest wall, x = 0; "
            "an iterative kind takes any trajectory",
        )


def _check_plates(spec: SimulationSpec) -> None:
    """Whether the plates can stand where they are asked for, and are as large as the breast."""
    p, c = spec.phantom, spec.compression
    upper, lower = p.semi_axes()[2:]
    if p.kind == "uploaded" and p.compressed:
        height = p.extent_mm[2] if p.extent_mm is not None else 0.0
        if p.thickness_mm is not None and p.thickness_mm < height - p.edge_mm("z"):
            message = f"the tissue is {height:g} mm high; at least that, or none"
            _refuse("phantom.thickness_mm", p.thickness_mm, message)
        return
    if c.chest_wall == "fixed_muscle" and Tissue.MUSCLE not in p.possible_tissues():
        message = "no value of phantom.tissues is muscle: a tissue map that has it, or another chest_wall"
        _refuse("compression.chest_wall", c.chest_wall, message)
    if c.thickness_mm is not None:
        # The mesh is a little thinner or thicker than the labels: what is near the limits is left to it.
        height = upper + lower
        least = height * (1 - c.percent / 100)
        if c.thickness_mm >= height * 1.02:
            message = (
                f"the breast is {height:.1f} mm thick before it is compressed: a distance of the plates below that"
            )
            _refuse("compression.thickness_mm", c.thickness_mm, message)
        if c.thickness_mm < least * 0.98:
            message = (
                f"the breast is {height:.1f} mm thick, and compression.percent = {c.percent:g} allows no less than "
                f"{least:.1f} mm: at least that, or a larger percent"
            )
            _refuse("compression.thickness_mm", c.thickness_mm, message)
    if c.elastic_plates is not None:
        depth, width, _ = compressed_extent(spec)
        for name, needed in (("depth_mm", depth), ("width_mm", width)):
            size = getattr(c.elastic_plates, name)
            if needed > size:
                message = (
                    f"the compressed breast is {needed:.0f} mm there and would reach beyond the plates: at least "
                    f"{math.ceil(needed * ADVICE_MARGIN)}"
                )
                _refuse(f"compression.elastic_plates.{name}", size, message)


def _check_reach_x(
    a: AcquisitionSpec, sources: NDArray[np.float64], depth: float, heights: tuple[float, float]
) -> None:
    """Whether the breast's shadow ends on the detector towards the nipple. heights: of its middle and its top, mm."""
    x, z = sources[:, 0], sources[:, 2]

    def reach(margin: float, height: float) -> float:
        return float(np.max(x + (margin * depth - x) * z / (z - height)))

    field = a.detector.pixels_x * a.detector.pixel_mm
    predicted = reach(SHADOW_MARGIN, heights[0])
    if predicted > field:
        _refuse(
            "acquisition.detector.pixels_x",
            a.detector.pixels_x,
            f"the breast reaches {predicted:.0f} mm from the chest wall on the detector, which is {field:.0f} mm deep; "
            f"{_pixels(reach(ADVICE_MARGIN, heights[1]), a)}, or acquisition.truncation = 'allow'",
        )


def _check_reach_y(
    a: AcquisitionSpec, sources: NDArray[np.float64], width: float, heights: tuple[float, float]
) -> None:
    """Whether it ends on the detector along the tube travel."""
    y, z = np.abs(sources[:, 1]), sources[:, 2]

    def reach(margin: float, height: float) -> float:
        m = z / (z - height)
        return float(np.max(margin * m * width / 2 + (m - 1) * y))

    field = a.detector.pixels_y * a.detector.pixel_mm / 2
    predicted = reach(SHADOW_MARGIN, heights[0])
    if predicted > field:
        _refuse(
            "acquisition.detector.pixels_y",
            a.detector.pixels_y,
            f"in the outermost view the breast reaches {predicted:.0f} mm from the middle of the detector, whose half "
            f"width is {field:.0f} mm; {_pixels(2 * reach(ADVICE_MARGIN, heights[1]), a)}, a smaller angular range, or "
            "acquisition.truncation = 'allow'",
        )


def _pixels(reach: float, a: AcquisitionSpec) -> str:
    """How many surely hold a shadow of ``reach`` mm; where there cannot be so many, how large they would have to be."""
    pixel = a.detector.pixel_mm
    count = 2 * math.ceil(reach / pixel / 2)
    if count <= MOST_PIXELS:
        return f"take at least {count} pixels"
    larger = math.ceil(100 * reach / MOST_PIXELS) / 100
    return f"take {MOST_PIXELS} pixels of at least {larger:g} mm (pixel_mm)"


def _refuse(name: str, value: float | str, message: str) -> NoReturn:
    shown = f"{value:g}" if isinstance(value, int | float) else value
    raise SpecError(
        f"{name} = {shown}: {message}",
        code="geometry-not-possible",
        problems=[{"field": name, "value": value, "message": message}],
    )
