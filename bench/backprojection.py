"""Back-projection of the paper's cup C against RTK: voxels, filtered back-projection, one iteration of SART.

    python -m bench.backprojection [--scale 1] [--views 5] [--slice-mm 4] [--rounds 3] [--threads 2]

The same slices, views and number of threads, in one process and in turns. A "ray" in the figures is one voxel seen in
one view. Values first:

- voxels: ours, as stored in 16 bits, against RTK's FDKBackProjection on random projections, away from the detector's
  edge (RTK leaves out what lies within half a pixel of it); both weigh with the square of the magnification. RTK's
  plain BackProjection, the peer of the ratio, is the same loop without that weight.
- the pair of SART: our projection of slices against RTK's Joseph on cubes, and <A x, y> = <x, A' y> for ours.
- filtered back-projection: times alone. RTK's FDK takes the first and last view for neighbours, all around the object,
  so its values are no reconstruction of a limited angle.
- SART: root mean square of the residual after one pass over all views from zero, of what each calls its result; every
  view by itself, relaxation 0.3, no negative values.

Last line: one JSON object; a ratio is time of the peer over ours.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from bench.support import rtk
from bench.support.scene import Scene, chosen_views, cup_c
from bench.support.timing import Timing, in_turns, machine_load
from simcore.core.artifacts import ProjectionStack
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.projection.integrals import line_integrals
from simcore.projection.signal import pixel_values
from simcore.reconstruction import FilteredBackprojection, reconstruct
from simcore.reconstruction.body import Body
from simcore.reconstruction.extent import volume_grid
from simcore.reconstruction.methods.algebraic import algebraic_correction
from simcore.reconstruction.methods.iterative import Measurement, subsets_of
from simcore.reconstruction.operators.backprojection import backproject_quantised, plan_backprojection
from simcore.reconstruction.operators.crossings import backproject, crossings_of, project_slices

FloatArray = NDArray[np.float32]
RELAXATION = 0.3
SLOPE, INTERCEPT = 1e-3, -32.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--views", type=int, default=5)
    parser.add_argument("--slice-mm", type=float, default=4.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=numba.get_num_threads())
    args = parser.parse_args()
    numba.set_num_threads(args.threads)
    rtk.set_threads(args.threads)
    scene = cup_c(args.scale)
    geometry = chosen_views(scene.geometry, args.views)
    spec = FilteredBackprojection(slice_mm=args.slice_mm)
    grid = volume_grid(geometry, spec, Body(scene.thickness_mm))
    rays = grid.size * geometry.views
    voxels = compared_voxels(geometry, grid, args.rounds)
    stack, integrals = acquired(scene, geometry)
    filtered = compared_fbp(stack, integrals, grid, spec, scene.thickness_mm, args.rounds)
    cubes = volume_grid(geometry, spec.with_(pixel_mm=args.slice_mm), Body(scene.thickness_mm))
    pair = compared_pair(geometry, grid, cubes)
    iteration = compared_sart(integrals, grid, geometry, args.rounds)
    print(
        json.dumps(
            {
                "ns_per_ray": voxels["ns_per_ray"],
                "peer_ns_per_ray": voxels["peer_ns_per_ray"],
                "ratio": voxels["ratio"],
                "rms_error": voxels["rms_error"],
                "peer": "RTK BackProjectionImageFilter",
                "voxels": voxels,
                "fbp": filtered,
                "pair": pair,
                "sart": iteration,
                "threads": args.threads,
                "rays": rays,
                "slices": grid.shape[0],
                "views": geometry.views,
                "rounds": args.rounds,
                "load": machine_load(),
            }
        )
    )
    return 0


def compared_voxels(geometry: AcquisitionGeometry, grid: Grid, rounds: int) -> dict[str, Any]:
    detector = geometry.detector
    projections = np.random.default_rng(1).standard_normal((geometry.views, detector.ny, detector.nx), np.float32)
    plan, poses = plan_backprojection(geometry, grid), rtk.geometry_of(geometry)
    out = np.empty(grid.shape, np.uint16)

    def ours() -> None:
        backproject_quantised(projections, plan, slice(0, grid.shape[1]), SLOPE, INTERCEPT, out)

    image = rtk.projections_of(projections, geometry)

    def peer(kind: str) -> Callable[[], Any]:
        itk_filter = rtk.backprojection(kind, rtk.volume_of(np.zeros(grid.shape, np.float32), grid), image, poses)
        return lambda: updated(itk_filter)

    timings = in_turns({"ours": lambda: ours, "peer": lambda: peer("voxel"), "peer_fdk": lambda: peer("fdk")}, rounds)
    expected = rtk.array_of_volume(timings["peer_fdk"].result)
    inside = seen_by_all(geometry, grid)
    error = rms((out * SLOPE + INTERCEPT - expected)[inside]) / rms(expected[inside])
    rays = grid.size * geometry.views
    return {
        "ns_per_ray": per_ray(timings["ours"], rays),
        "peer_ns_per_ray": per_ray(timings["peer"], rays),
        **ratios(timings["ours"], timings["peer"]),
        "peer_with_weight_ns_per_ray": per_ray(timings["peer_fdk"], rays),
        "rms_error": rounded(error),
        "rms_of_rounding": rounded(SLOPE / 12**0.5 / rms(expected[inside])),
    }


def seen_by_all(geometry: AcquisitionGeometry, grid: Grid) -> NDArray[np.bool_]:
    """Voxels whose rays meet the detector at least one pixel from its edge in every view."""
    detector = geometry.detector
    z = grid.centres("z")[:, None, None]
    inside = np.ones(grid.shape, np.bool_)
    for source in geometry.sources:
        magnification = source[2] / (source[2] - z)
        x = source[0] + (grid.centres("x") - source[0]) * magnification
        y = source[1] + (grid.centres("y")[:, None] - source[1]) * magnification
        inside &= (x > detector.x_centres()[1]) & (x < detector.x_centres()[-2])
        inside &= (y > detector.y_centres()[1]) & (y < detector.y_centres()[-2])
    return inside


def acquired(scene: Scene, geometry: AcquisitionGeometry) -> tuple[ProjectionStack, FloatArray]:
    """The detector's signal, and the line integrals it was made of."""
    integrals = np.stack([line_integrals(scene.breast, geometry, view, scene.mu()) for view in range(geometry.views)])
    data = np.empty(integrals.shape, np.uint16)
    for view in range(geometry.views):
        pixel_values(integrals[view], 60000.0, 16, data[view])
    return ProjectionStack(data, 60000.0, geometry), integrals


def compared_fbp(
    stack: ProjectionStack,
    integrals: FloatArray,
    grid: Grid,
    spec: FilteredBackprojection,
    thickness_mm: float,
    rounds: int,
) -> dict[str, Any]:
    poses, image = rtk.geometry_of(stack.geometry), rtk.projections_of(integrals, stack.geometry)

    def peer() -> Callable[[], Any]:
        itk_filter = rtk.fdk(rtk.volume_of(np.zeros(grid.shape, np.float32), grid), image, poses)
        return lambda: updated(itk_filter)

    timings = in_turns({"ours": lambda: lambda: reconstruct(stack, spec, thickness_mm), "peer": peer}, rounds)
    return {
        "seconds": round(timings["ours"].wall_s, 3),
        "peer_seconds": round(timings["peer"].wall_s, 3),
        **ratios(timings["ours"], timings["peer"]),
    }


def compared_pair(geometry: AcquisitionGeometry, grid: Grid, cubes: Grid) -> dict[str, float]:
    """Ours against RTK's Joseph on cubes, where both step from slice to slice; with voxels as flat as slices usually
    are, RTK steps along y on inclined rays. Adjointness on the slices of the bench."""
    two = chosen_views(geometry, 2)
    rng = np.random.default_rng(2)
    volume = rng.random(cubes.shape, np.float32)
    # RTK counts the outermost slices half, and nothing beyond the centres of the outermost voxels.
    volume[[0, -1]] = volume[:, [0, -1]] = volume[:, :, [0, -1]] = 0.0
    own = project_slices(volume, cubes, two)
    projector = rtk.joseph(
        rtk.projections_of(np.zeros_like(own), two), rtk.volume_of(volume, cubes), rtk.geometry_of(two)
    )
    peer = rtk.array_of_projections(updated(projector))
    rays, volume = rng.standard_normal(own.shape, np.float32), rng.random(grid.shape, np.float32)
    forward = float(np.vdot(project_slices(volume, grid, two).astype(np.float64), rays))
    back = float(np.vdot(volume, backproject(rays, grid, two).astype(np.float64)))
    return {
        "rms_difference_to_joseph": rounded(rms(own - peer) / rms(peer)),
        "adjointness": rounded(abs(forward / back - 1.0)),
    }


def compared_sart(integrals: FloatArray, grid: Grid, geometry: AcquisitionGeometry, rounds: int) -> dict[str, Any]:
    measurement = Measurement(integrals, crossings_of(grid, geometry))
    subsets = subsets_of(geometry.angles, 1)

    def ours() -> Callable[[], FloatArray]:
        volume, correct = np.zeros(grid.shape, np.float32), algebraic_correction(measurement, RELAXATION, True)

        def run() -> FloatArray:
            for subset in subsets:
                correct(volume, subset)
            return volume

        return run

    poses, image = rtk.geometry_of(geometry), rtk.projections_of(integrals, geometry)

    def peer() -> Callable[[], Any]:
        itk_filter = rtk.sart(rtk.volume_of(np.zeros(grid.shape, np.float32), grid), image, poses, RELAXATION)
        return lambda: updated(itk_filter)

    timings = in_turns({"ours": ours, "peer": peer}, rounds)
    volumes = {"ours": timings["ours"].result, "peer": rtk.array_of_volume(timings["peer"].result)}
    residuals = {n: rms(project_slices(v, grid, geometry) - integrals) / rms(integrals) for n, v in volumes.items()}
    return {
        "seconds": round(timings["ours"].wall_s, 3),
        "peer_seconds": round(timings["peer"].wall_s, 3),
        **ratios(timings["ours"], timings["peer"]),
        "relative_residual": rounded(residuals["ours"]),
        "peer_relative_residual": rounded(residuals["peer"]),
    }


def updated(itk_filter: Any) -> Any:
    itk_filter.Update()
    return itk_filter.GetOutput()


def ratios(ours: Timing, peer: Timing) -> dict[str, float]:
    return {"ratio": round(peer.wall_s / ours.wall_s, 1), "cpu_ratio": round(peer.cpu_s / ours.cpu_s, 1)}


def per_ray(timing: Timing, rays: int) -> float:
    return round(timing.wall_s / rays * 1e9, 3)


def rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def rounded(value: float) -> float:
    return float(f"{value:.3g}")


if __name__ == "__main__":
    sys.exit(main())
