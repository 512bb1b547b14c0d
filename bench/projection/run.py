"""The projector against closed forms: orders of convergence, and what voxels, rays and partial volume are worth.

    python -m bench.projection          writes docs/projection_accuracy.md

The scene is one with exact line integrals: a ball of fat with capsules of 0.4 mm around masses (balls.py).
Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.projection.balls import Balls, balls, integrals, voxels
from bench.projection.page import page
from bench.support.timing import in_turns, machine_load
from simcore.core.artifacts import Phantom
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.grid import Grid
from simcore.core.tissues import MAX_TISSUES
from simcore.projection import geometry_of
from simcore.projection.borders import borders_of
from simcore.projection.integrals import basis_integrals, line_integrals
from simcore.projection.materials import attenuation_table
from simcore.projection.rays import project_rays
from simcore.projection.spec import AcquisitionSpec, DetectorSpec
from simcore.projection.stage import with_rays

ROOT = Path(__file__).parents[2]
EDGES = (1.6, 0.8, 0.4, 0.2)
STEPS = (0.45, 0.225, 0.1125, 0.05625)
LEVELS = 256
"""Mixtures of tissues that a partial-volume map can tell apart."""

Array = NDArray[np.float64]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "projection_accuracy.md")
    args = parser.parse_args()
    scene, mu = balls(), attenuation_table("johns-yaffe-20keV")
    result: dict[str, Any] = {
        "voxels": convergence_of_voxels(scene, mu),
        "steps": convergence_of_steps(scene, mu),
        "pixels": errors_of_pixels(scene, mu),
        "maps": cost_of_maps(scene, mu),
        "load": machine_load(),
    }
    args.out.write_text(page(result))
    print(json.dumps(result))
    return 0


def acquisition(pixel: float) -> AcquisitionGeometry:
    """One oblique view of the scene."""
    cells = round(72.0 / pixel)
    detector = DetectorSpec(pixels_y=2 * cells, pixels_x=cells, pixel_mm=pixel)
    return geometry_of(AcquisitionSpec(views=3, detector=detector, truncation="allow"))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def convergence_of_voxels(scene: Balls, mu: Array, edges: tuple[float, ...] = EDGES) -> list[dict[str, float]]:
    """Errors of the line integrals as voxels shrink, the step of the samples with them (0.45 voxels)."""
    geometry = acquisition(0.5)
    truth = integrals(scene, geometry, 0, mu)
    lit = truth > 0
    table = []
    for edge in edges:
        phantom = voxels(scene, edge)
        exact = line_integrals(phantom, geometry, 0, mu)[lit]
        sampled = line_integrals(phantom, geometry, 0, mu, sampling="trilinear")[lit]
        table.append(
            {
                "edge_mm": edge,
                "exact": rms(exact - truth[lit]),
                "trilinear": rms(sampled - truth[lit]),
                "difference": rms(sampled - exact),
            }
        )
    return table


def convergence_of_steps(scene: Balls, mu: Array, edge: float = 0.8) -> list[dict[str, float]]:
    """Errors of the samples as their step alone shrinks, against steps of 0.005 voxels."""
    geometry = acquisition(0.5)
    phantom = voxels(scene, edge)

    def sampled(step: float) -> Array:
        return line_integrals(phantom, geometry, 0, mu, sampling="trilinear", step_voxels=step).astype(np.float64)

    limit = sampled(0.005)
    return [{"step": step, "error": rms((sampled(step) - limit)[limit > 0])} for step in STEPS]


def errors_of_pixels(scene: Balls, mu: Array, pixel: float = 0.2) -> list[dict[str, Any]]:
    """Errors of I / I0 of pixels against their mean over 8 x 8 closed-form rays."""
    geometry = acquisition(pixel)
    truth = _mean_intensity(lambda fine: integrals(scene, fine, 0, mu), geometry, 8)
    lit = truth < 0.999
    table = []
    for edge in (0.4, 0.2, 0.1):
        phantom = voxels(scene, edge)
        forms: dict[str, tuple[Phantom, Array]] = {"labels": (phantom, mu)}
        if edge > 0.1:
            forms["partial volume"] = partial_volume(scene, mu, edge)
        for form, (labels, values) in forms.items():
            for rays in (1, 2, 4):
                start = time.perf_counter()
                image = _mean_intensity(_siddon(labels, values), geometry, rays)
                seconds = time.perf_counter() - start
                error = (image - truth)[lit] / truth[lit]
                table.append(
                    {
                        "edge_mm": edge,
                        "form": form,
                        "rays": rays,
                        "rms": rms(error),
                        "p999": float(np.quantile(np.abs(error), 0.999)),
                        "voxels": labels.labels.size,
                        "seconds_double": round(seconds, 2),
                    }
                )
    return table


def _siddon(phantom: Phantom, values: Array) -> Callable[[AcquisitionGeometry], Array]:
    def project(geometry: AcquisitionGeometry) -> Array:
        out = np.empty((geometry.detector.ny, geometry.detector.nx))
        project_rays(phantom.labels, phantom.grid.moved(z=geometry.support_height), geometry, 0, values, out=out)
        return out

    return project


def _mean_intensity(project: Callable[[AcquisitionGeometry], Array], geometry: AcquisitionGeometry, rays: int) -> Array:
    fine = np.exp(-project(with_rays(geometry, rays)))
    ny, nx = geometry.detector.ny, geometry.detector.nx
    return np.asarray(fine.reshape(ny, rays, nx, rays).mean(axis=(1, 3)))


def partial_volume(scene: Balls, mu: Array, edge: float, parts: int = 4) -> tuple[Phantom, Array]:
    """Every voxel the mean attenuation of parts^3 labels in it, in LEVELS steps: labels and their attenuation."""
    fine = voxels(scene, edge / parts)
    cells = fine.labels.shape[0] // parts
    top = float(mu[np.unique(scene.labels)].max())
    levels = np.empty((cells, cells, cells), np.uint8)
    for k in range(cells):
        slab = mu[fine.labels[k * parts : (k + 1) * parts]].astype(np.float32)
        mean = slab.reshape(parts, cells, parts, cells, parts).mean(axis=(0, 2, 4))
        levels[k] = np.rint(mean / top * (LEVELS - 1))
    return Phantom(levels, Grid(levels.shape, (edge, edge, edge), fine.grid.corner)), np.linspace(0.0, top, LEVELS)


def cost_of_maps(scene: Balls, mu: Array) -> dict[str, float]:
    """One pass with four maps against four passes with one, CPU seconds of the same work in turns."""
    phantom, geometry = voxels(scene, 0.2), acquisition(0.1)
    basis = np.stack([mu, 0.5 * mu, mu**2, np.sqrt(mu)])
    assert basis.shape == (4, MAX_TISSUES)
    borders = borders_of(phantom.labels)
    timings = in_turns(
        {
            "one": lambda: lambda: line_integrals(phantom, geometry, 0, mu, borders=borders),
            "four": lambda: lambda: [line_integrals(phantom, geometry, 0, b, borders=borders) for b in basis],
            "maps": lambda: lambda: basis_integrals(phantom, geometry, 0, basis, borders=borders),
        },
        5,
    )
    error = max(float(np.abs(a - b).max()) for a, b in zip(timings["four"].result, timings["maps"].result, strict=True))
    seconds = {f"{name}_s": round(timing.cpu_s, 4) for name, timing in timings.items()}
    return {**seconds, "ratio": round(timings["four"].cpu_s / timings["maps"].cpu_s, 2), "largest_difference": error}
