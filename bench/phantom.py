"""Phantom generation: voxels a second, against region growing and every seed at every voxel; one run.

    python -m bench.phantom [--fine-mm 0.1] [--runs 3] [--peer-mm 2.0]

First the values: labels and compartments of a cup C at ``--peer-mm`` against the two plain methods of the tests. Then
the seconds of the whole stage (outline, seeds, voxels, counting) at 0.2 mm and ``--fine-mm`` with 1 and 2 threads, the
least of ``--runs``, and of a textured one; slabs of 0.05 mm voxels are timed for a few slabs. Processor seconds, which
do not depend on what else the machine does, stand beside. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from itertools import islice
from typing import Any

import numba
import numpy as np

from simcore import phantom
from simcore.core.memory import peak_bytes, reset_peak
from simcore.core.tissues import Tissue
from simcore.phantom.anthropomorphic import Breast, settle, slabs
from simcore.phantom.spec import AnthropomorphicPhantom, DuctSpec, NippleSpec, TextureSpec
from simcore.phantom.survey import survey
from tests.support import oracles

SEED = 1
CUP_C = AnthropomorphicPhantom()
EXTRAS = {
    "texture": CUP_C.with_(texture=TextureSpec(amplitude_mm=2.0)),
    "all": CUP_C.with_(texture=TextureSpec(amplitude_mm=2.0), nipple=NippleSpec(), ducts=DuctSpec()),
}
CHUNK = 4000
"""Points at which every seed is evaluated at a time."""
STREAMED_SLABS = 3


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fine-mm", type=float, default=0.1)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--peer-mm", type=float, default=2.0)
    args = parser.parse_args()
    figures: dict[str, Any] = compared(args.peer_mm)
    threads = [n for n in (1, 2) if n <= numba.config.NUMBA_NUM_THREADS]
    for spec in (CUP_C, *EXTRAS.values()):
        phantom.generate(spec.with_(voxel_mm=1.0), SEED)  # loads compiled code
    for voxel in (0.2, args.fine_mm):
        for n in threads:
            figures[f"{voxel:g}_mm_{n}_threads"] = timed(CUP_C.with_(voxel_mm=voxel), n, args.runs)
    for name, spec in EXTRAS.items():
        figures[f"0.2_mm_{name}_{threads[-1]}_threads"] = timed(spec, threads[-1], args.runs)
    figures["streaming_0.05_mm"] = streamed(0.05)
    rate = figures["0.2_mm_1_threads"]["voxels_per_processor_second"]
    figures["ratio_region_growing"] = round(rate / figures["region_growing_voxels_per_second"], 1)
    figures["ratio_every_seed"] = round(rate / figures["every_seed_voxels_per_second"], 1)
    print(json.dumps(figures))
    return 0


def compared(voxel_mm: float) -> dict[str, Any]:
    """Values and seconds of the plain methods."""
    breast = settle(CUP_C.with_(voxel_mm=voxel_mm), SEED)
    inside, points = _tissue_points(breast)
    cells = breast.compartments
    labels = np.zeros(breast.shape.grid.shape, np.uint8)
    breast.fill(labels)

    start = time.perf_counter()
    expected, doubt = _every_seed(breast, points)
    every_seed = len(points) / (time.perf_counter() - start)
    differ = (labels[inside] != expected) & (doubt > 1e-4)

    start = time.perf_counter()
    regions = oracles.grow_regions(cells.table, breast.shape.grid, inside)[inside]
    growing = len(points) / (time.perf_counter() - start)
    whole = settle(CUP_C.with_(voxel_mm=voxel_mm), SEED)
    ours = survey(whole.shape, whole.texture, cells.table, cells.gland_seeds, CUP_C.compartments.ligament_mm)
    same = np.mean(regions == ours.first) if ours.stride == 1 else None
    return {
        "peer_voxel_mm": voxel_mm,
        "labels_that_differ": int(np.count_nonzero(differ)),
        "labels_compared": len(points),
        "same_compartment_as_region_growing": None if same is None else round(float(same), 4),
        "every_seed_voxels_per_second": round(every_seed),
        "region_growing_voxels_per_second": round(growing),
    }


def timed(spec: AnthropomorphicPhantom, threads: int, runs: int) -> dict[str, Any]:
    """The least seconds of the stage."""
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        times = []
        reset_peak()
        for _ in range(runs):
            start, processor = time.perf_counter(), time.process_time()
            grown = phantom.generate(spec, SEED)
            times.append((time.perf_counter() - start, time.process_time() - processor))
            voxels = grown.grid.size
            del grown
    finally:
        numba.set_num_threads(before)
    seconds, processor_seconds = min(t[0] for t in times), min(t[1] for t in times)
    print(f"{spec.voxel_mm:g} mm, {threads} threads: {seconds:.2f} s", file=sys.stderr, flush=True)
    return {
        "seconds": round(seconds, 3),
        "processor_seconds": round(processor_seconds, 3),
        "voxels": voxels,
        "voxels_per_second": round(voxels / seconds),
        "voxels_per_processor_second": round(voxels / processor_seconds),
        "peak_memory_GB": round(peak_bytes() / 1e9, 2),
    }


def streamed(voxel_mm: float) -> dict[str, Any]:
    """A few slabs from the lowest of the breast, and what the whole of it would hold."""
    spec = CUP_C.with_(voxel_mm=voxel_mm)
    reset_peak()
    start = time.perf_counter()
    voxels = tissue = 0
    for _, labels in islice(slabs(spec, SEED), STREAMED_SLABS):
        voxels += labels.size
        tissue += int(np.count_nonzero(labels != Tissue.AIR))
    seconds = time.perf_counter() - start
    return {
        "slabs": STREAMED_SLABS,
        "voxels": voxels,
        "voxels_of_the_whole": spec.voxels,
        "tissue_voxels": tissue,
        "seconds_with_set_up": round(seconds, 2),
        "peak_memory_GB": round(peak_bytes() / 1e9, 2),
    }


def _every_seed(breast: Breast, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    cells, thickness = breast.compartments, breast.spec.compartments.ligament_mm

    def parts() -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for first in range(0, len(points), CHUNK):
            yield oracles.tissue(cells.table, cells.gland_seeds, thickness, points[first : first + CHUNK])

    labels, doubts = zip(*parts(), strict=True)
    return np.concatenate(labels), np.concatenate(doubts)


def _tissue_points(breast: Breast) -> tuple[np.ndarray, np.ndarray]:
    """Voxels inside the skin (nz, ny, nx), and their centres (n, 3), mm."""
    grid = breast.shape.grid
    inside = np.arange(grid.shape[2]) < breast.shape.tissue_rows[:, :, None]
    k, j, i = np.nonzero(inside)
    return inside, np.stack([grid.centres(axis)[n] for axis, n in (("x", i), ("y", j), ("z", k))], axis=1)


if __name__ == "__main__":
    sys.exit(main())
