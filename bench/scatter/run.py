"""Transport of photons: efficiency, 1 / (variance x processor time), against plain analog transport of our own.

    python -m bench.scatter          (about a minute)

The same breast under the same beam, both by the same scene, tables and scattering; variance of the scatter on square
centimetres of the breast's shadow and of the dose to gland. A wheel of Geant4 is asked for as well: geant4-pybind needs
data sets that its wheel does not have and that it loads from the network at its import, so it is compared only where
they are installed, and told otherwise. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from bench.physics_transport.analog import simulate_analog
from bench.physics_transport.tg195 import CASES
from bench.scatter.bodies import arc, breast, pmma_plates
from simcore.core.geometry import AcquisitionGeometry
from simcore.core.progress import silent
from simcore.core.tissues import Tissue
from simcore.physics.materials import tissue_sets
from simcore.transport.cells import LABELS
from simcore.transport.monte_carlo import Sums, error, mean, simulate
from simcore.transport.response import IDEAL, tabulated
from simcore.transport.scene import Setting
from simcore.transport.spec import TransportSpec
from simcore.transport.stage import by_label, cells_of_phantom, setting_in

SQUARE_CM = 10.0
WARM_UP = 2_000
RESPONSE = tabulated(IDEAL, None, 40.0)
SPECTRUM = CASES[2].spectrum


def breast_setting(thickness: float, voxel: float = 0.5) -> tuple[Setting, AcquisitionGeometry]:
    """A breast between plates, and a geometry with its support."""
    phantom, geometry, spec = breast(thickness, voxel), arc([0.0]), TransportSpec()
    tissues = by_label(phantom, tissue_sets()["icru-hammerstein"])
    cells = cells_of_phantom(phantom, geometry, np.eye(LABELS), spec.cell_mm)
    return setting_in(cells, tissues, pmma_plates(geometry.support_height, thickness), spec, geometry), geometry


def by_expected_values(setting: Setting, geometry: AcquisitionGeometry, rays: int, seed: int = 1) -> Sums:
    """The product's transport."""
    return simulate(
        setting, geometry, SPECTRUM, RESPONSE,
        rays=rays, grid_mm=SQUARE_CM, capped=(), seed=seed, purpose="bench", progress=silent,
    )  # fmt: skip


def analog(setting: Setting, geometry: AcquisitionGeometry, photons: int, seed: int = 1) -> Sums:
    """Plain transport."""
    return simulate_analog(
        setting, geometry, SPECTRUM, RESPONSE, photons=photons, grid_mm=SQUARE_CM, seed=seed
    )  # fmt: skip


def timed(run: Callable[[int], Sums], count: int) -> tuple[Sums, float]:
    """Sums and processor seconds; a short run comes first, which loads compiled code."""
    run(WARM_UP)
    start = time.process_time()
    return run(count), time.process_time() - start


def variances(sums: Sums) -> tuple[float, float]:
    """Relative variance of scatter on cells of the shadow (mean over them) and of the dose to gland."""
    shadow = sums.primary.shadow[0]
    scatter = (error(sums.signal)[0, 0] / mean(sums.signal)[0, 0])[shadow] ** 2
    gland = sums.deposit[..., Tissue.GLAND]
    return float(scatter.mean()), float((error(gland) / mean(gland))[0] ** 2)


def geant4() -> str | None:
    """None where a wheel of Geant4 can be imported without the network; otherwise why not."""
    code = "import geant4_pybind"
    ended = subprocess.run([sys.executable, "-c", code], stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if ended.returncode == 0:
        return None
    if "No module named" in ended.stderr:
        return "geant4-pybind is not installed"
    return "geant4-pybind asks for data sets from the network: " + (ended.stdout.strip().splitlines() or [""])[0]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rays", type=int, default=300_000)
    parser.add_argument("--photons", type=int, default=4_000_000)
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for thickness, angle in ((50.0, 0.0), (50.0, 20.0), (40.0, 0.0), (60.0, 20.0)):
        setting, _ = breast_setting(thickness)
        geometry = arc([angle])
        plain, plain_s = timed(lambda n, s=setting, g=geometry: analog(s, g, n), args.photons)  # type: ignore[misc]
        fast, fast_s = timed(lambda n, s=setting, g=geometry: by_expected_values(s, g, n), args.rays)  # type: ignore[misc]
        plain_scatter, plain_dose = variances(plain)
        fast_scatter, fast_dose = variances(fast)
        rows.append(
            {
                "thickness_mm": thickness,
                "angle_degrees": angle,
                "scatter_efficiency": plain_scatter * plain_s / (fast_scatter * fast_s),
                "dose_efficiency": plain_dose * plain_s / (fast_dose * fast_s),
                "photons_per_second": args.photons / plain_s,
                "rays_per_second": args.rays / fast_s,
                "scatter_ratio": float(mean(fast.signal)[0, 0].sum() / mean(plain.signal)[0, 0].sum()),
            }
        )
        print(rows[-1], flush=True)
    reason = geant4()
    print("Geant4:", reason or "its wheel can be imported here, but no adapter is written for it")
    efficiency = float(np.mean([row["scatter_efficiency"] for row in rows]))
    print(
        json.dumps(
            {
                "photons_per_second": round(float(np.mean([row["rays_per_second"] for row in rows]))),
                "efficiency_vs_analog": round(efficiency, 2),
                "peer": None,
                "peer_missing": reason or "no adapter",
                "ratio": None,
                "rows": rows,
            }
        )
    )
    return 0
