"""The transport of photons against published tables, closed forms and plain analog transport, in its long form.

    python -m bench.physics_transport          (some minutes)

Every row: check, value, reference, tolerance, verdict. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass

import numpy as np

from bench.physics_transport.analog import simulate_analog
from bench.physics_transport.tg195 import CASES, run_case
from bench.scatter.bodies import arc, beam, block_setting
from bench.scatter.run import RESPONSE, SPECTRUM, breast_setting
from simcore.core.progress import silent
from simcore.physics.materials import material
from simcore.transport.denoising import denoised
from simcore.transport.monte_carlo import Sums, mean, simulate
from simcore.transport.response import IDEAL, tabulated
from simcore.transport.views import cell_sides

SLABS = ((20, 0.268), (80, 1.124))
SALVAGNINI = "Salvagnini et al. 2012"
VIEWS = 15
ARC_DEGREES = 20.0
GRID_MM = 5.0


@dataclass(frozen=True)
class Row:
    """One check. tolerance: absolute."""

    name: str
    value: float
    reference: float
    tolerance: float
    source: str

    @property
    def holds(self) -> bool:
        """Whether the value lies within the tolerance."""
        return abs(self.value - self.reference) <= self.tolerance


def tg195_rows(rays: int) -> list[Row]:
    """Totals inside the range of the codes, volumes of interest within 2.5 %; three standard errors are allowed."""
    rows = []
    for case in CASES:
        outcome = run_case(case, rays)
        low, high = case.codes
        name = f"TG-195 case 3, {case.beam}, {case.angle:g} degrees"
        source = "Sechopoulos et al. 2015"
        middle, half = (low + high) / 2, (high - low) / 2
        rows.append(Row(f"{name}: tissue [eV]", outcome.tissue, middle, half + 3 * outcome.tissue_error, source))
        volumes = zip(outcome.volumes, case.volumes, outcome.volume_errors, strict=True)
        rows += [
            Row(f"{name}: volume {n} [eV]", float(v), ref, 0.025 * ref + 3 * float(deviation), source)
            for n, (v, ref, deviation) in enumerate(volumes, 1)
        ]
    return rows


def slab_rows(rays: int) -> list[Row]:
    """Scatter-to-primary of bare PMMA, 240 x 180 mm, air gap 20 mm, middle of the field, within 10 %."""
    rows = []
    for thickness, reference in SLABS:
        setting = block_setting(material("pmma"), (180.0, 240.0, float(thickness)), bottom=20.0)
        sums = simulate(
            setting, arc([0.0], support=20.0), beam([20.0]), tabulated(IDEAL, None, 40.0),
            rays=rays, grid_mm=10.0, capped=(), seed=1, purpose="slab", progress=silent,
        )  # fmt: skip
        middle = np.s_[11:15, 4:8]
        value = float(mean(sums.signal)[0, 0][middle].sum() / sums.primary.signal[0][middle].sum())
        rows.append(Row(f"scatter to primary, PMMA {thickness} mm", value, reference, 0.1 * reference, SALVAGNINI))
    return rows


def scatter_rows(photons: int, rays: int) -> list[Row]:
    """Smooth maps of one acquisition against analog photons, square centimetres of the shadow, two views."""
    setting, _ = breast_setting(50.0)
    angles = list(np.linspace(-ARC_DEGREES, ARC_DEGREES, VIEWS))
    geometry = arc(angles)
    sums = simulate(
        setting, geometry, SPECTRUM, RESPONSE,
        rays=rays, grid_mm=GRID_MM, capped=(), seed=1, purpose="breast", progress=silent,
    )  # fmt: skip
    raw = mean(sums.signal)[:, 0]
    sides = cell_sides(geometry, (raw.shape[1], raw.shape[2]))
    smooth = denoised(raw, sums.primary, sides, geometry.angles)
    rows = []
    for view in (VIEWS // 2, VIEWS - 1):
        plain = simulate_analog(
            setting, arc([angles[view]]), SPECTRUM, RESPONSE, photons=photons, grid_mm=GRID_MM, seed=2
        )  # fmt: skip
        rms, total, total_error = compared(smooth[view], plain, sums.primary.shadow[view])
        name = f"scatter, {angles[view]:.0f} degrees, against {photons:.0e} analog photons"
        rows.append(Row(f"{name}: rms [%]", 100 * rms, 0.0, 2.5, "analog transport of our own"))
        rows.append(
            Row(f"{name}: mean [%]", 100 * total, 0.0, 0.5 + 300 * total_error, "analog transport of our own")
        )  # fmt: skip
    return rows


def compared(smooth: np.ndarray, plain: Sums, shadow: np.ndarray) -> tuple[float, float, float]:
    """Relative rms difference on 2 x 2 cells wholly in the shadow, without what is noise of the analog map;
    relative difference of the totals and its standard error from the analog photons."""
    wholly = blocks_of(shadow.astype(np.float64)) == 4
    reference = blocks_of(mean(plain.signal)[0, 0])[wholly]
    by_block = np.stack([blocks_of(block) for block in plain.signal[0, :, 0]])[:, wholly]
    noise = by_block.std(axis=0, ddof=1) / np.sqrt(len(by_block))
    value = blocks_of(smooth)[wholly]
    square = np.mean((value / reference - 1) ** 2 - (noise / reference) ** 2)
    total = by_block.sum(axis=1)
    spread = float(total.std(ddof=1) / np.sqrt(len(total)) / total.mean())
    return float(np.sqrt(max(0.0, square))), float(value.sum() / reference.sum() - 1), spread


def blocks_of(cells: np.ndarray) -> np.ndarray:
    """Sums of 2 x 2 cells."""
    rows, columns = (count // 2 * 2 for count in cells.shape)
    return cells[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2).sum(axis=(1, 3))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tg195-rays", type=int, default=3_000_000)
    parser.add_argument("--slab-rays", type=int, default=300_000)
    parser.add_argument("--rays", type=int, default=75_000)
    parser.add_argument("--photons", type=int, default=100_000_000)
    args = parser.parse_args()
    rows: list[Row] = []
    for part in (
        lambda: tg195_rows(args.tg195_rays), lambda: slab_rows(args.slab_rays),
        lambda: scatter_rows(args.photons, args.rays),
    ):  # fmt: skip
        for row in part():
            verdict = "holds" if row.holds else "MISSED"
            print(f"{row.name}: {row.value:.4g}, {row.reference:.4g} +- {row.tolerance:.2g}: {verdict}", flush=True)
            rows.append(row)
    failed = [row for row in rows if not row.holds]
    print(json.dumps({"checks": len(rows), "failed": len(failed), "rows": [asdict(row) for row in rows]}))
    return 1 if failed else 0
