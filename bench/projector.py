"""Line integrals of the paper's cup C: this project's exact projector, RTK's Joseph, the paper's trilinear samples.

    python -m bench.projector [--scale 1] [--views 3] [--rounds 3] [--threads 2]

The same voxels, rays and number of threads, in one process and in turns. Values first: each against Siddon's sums in
double precision on rays drawn at random from the shadow; and RTK's Joseph against the Joseph of this project's
reconstruction on the same volume, which shows that both mean the same geometry. What each needs once for all views
(attenuation per voxel for RTK, the borders between tissues here) is not timed. ``--scale 4``: edges four times longer,
quick.
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
from bench.support.siddon import siddon
from bench.support.timing import Timing, in_turns, machine_load
from simcore.core.geometry import AcquisitionGeometry
from simcore.projection.borders import borders_of
from simcore.projection.integrals import line_integrals
from simcore.reconstruction.operators.crossings import project_slices

FloatArray = NDArray[np.float32]
RAYS = 600
"""Of each view that values are compared on."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=numba.get_num_threads())
    args = parser.parse_args()
    numba.set_num_threads(args.threads)
    rtk.set_threads(args.threads)
    scene = cup_c(args.scale)
    geometry = chosen_views(scene.geometry, args.views)
    borders = borders_of(scene.breast.labels)
    mu = borders.present(scene.mu())
    attenuation = mu.astype(np.float32)[scene.breast.labels]

    def ours(sampling: str) -> Callable[[], FloatArray]:
        def run() -> FloatArray:
            views = [
                line_integrals(scene.breast, geometry, view, mu, sampling=sampling, borders=borders)  # type: ignore[arg-type]
                for view in range(geometry.views)
            ]
            return np.stack(views)

        return run

    volume, poses = rtk.volume_of(attenuation, scene.grid), rtk.geometry_of(geometry)

    def joseph() -> Callable[[], Any]:
        empty = np.zeros((geometry.views, geometry.detector.ny, geometry.detector.nx), np.float32)
        projector = rtk.joseph(rtk.projections_of(empty, geometry), volume, poses)

        def run() -> Any:
            projector.Update()
            return projector.GetOutput()

        return run

    timings = in_turns(
        {"exact": lambda: ours("exact"), "peer_joseph": joseph, "peer_paper": lambda: ours("trilinear")}, args.rounds
    )
    joseph_values = rtk.array_of_projections(timings["peer_joseph"].result)
    values = {"exact": timings["exact"].result, "joseph": joseph_values, "paper": timings["peer_paper"].result}
    errors = errors_of(values, scene, geometry, mu)
    rays = joseph_values.size
    figures = {
        "ns_per_ray": per_ray(timings["exact"], rays),
        "peer_ns_per_ray": per_ray(timings["peer_joseph"], rays),
        "ratio": ratio(timings, "peer_joseph"),
        "rms_error": errors["exact"],
        "peer": "RTK JosephForwardProjectionImageFilter",
        "peer_rms_error": errors["joseph"],
        "peer_rms_difference_to_own_joseph": joseph_difference(joseph_values, attenuation, scene, geometry),
        "paper_ns_per_ray": per_ray(timings["peer_paper"], rays),
        "paper_ratio": ratio(timings, "peer_paper"),
        "paper_rms_error": errors["paper"],
        "cpu_ratio": ratio(timings, "peer_joseph", cpu=True),
        "paper_cpu_ratio": ratio(timings, "peer_paper", cpu=True),
        "rms_of_integrals": errors["reference"],
        "threads": args.threads,
        "rays": rays,
        "voxels": attenuation.size,
        "rounds": args.rounds,
        "load": machine_load(),
    }
    print(json.dumps(figures))
    return 0


def per_ray(timing: Timing, rays: int) -> float:
    return round(timing.wall_s / rays * 1e9, 2)


def ratio(timings: dict[str, Timing], peer: str, cpu: bool = False) -> float:
    own, other = timings["exact"], timings[peer]
    return round(other.cpu_s / own.cpu_s if cpu else other.wall_s / own.wall_s, 1)


def errors_of(
    values: dict[str, FloatArray], scene: Scene, geometry: AcquisitionGeometry, mu: NDArray[np.float64]
) -> dict[str, float]:
    """Root mean square difference to double precision, on rays through the breast; "reference": of the integrals."""
    rng = np.random.default_rng(3)
    reference, samples = [], {name: [] for name in values}  # type: dict, list
    for view in range(geometry.views):
        lit = np.argwhere(values["exact"][view] > 0)
        for j, i in lit[rng.choice(len(lit), RAYS)]:
            pixel = geometry.pixel_position(view, j, i)
            reference.append(siddon(scene.breast.labels, scene.grid, geometry.sources[view], pixel, mu))
            for name, array in values.items():
                samples[name].append(float(array[view, j, i]))
    errors = {name: rms(np.subtract(numbers, reference)) for name, numbers in samples.items()}
    return {name: float(f"{error:.3g}") for name, error in {**errors, "reference": rms(np.array(reference))}.items()}


def joseph_difference(peer: FloatArray, attenuation: FloatArray, scene: Scene, geometry: AcquisitionGeometry) -> float:
    """Root mean square difference of the two Josephs.

    RTK counts the first and last slice half, and nothing before the first voxel centre: it is set right for the
    former, and columns next to the chest wall are left out.
    """
    own = project_slices(attenuation, scene.grid, geometry)
    ends = np.zeros_like(attenuation)
    ends[[0, -1]] = attenuation[[0, -1]] / 2
    own -= project_slices(ends, scene.grid, geometry)
    return float(f"{rms((peer - own)[:, :, 4:]):.3g}")


def rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


if __name__ == "__main__":
    sys.exit(main())
