"""Export of a full-size case in every encoding: seconds, megabytes, and memory beyond the arrays.

    python -m bench.dicom_export [--slices 60] [--views 15] [--extra]

2304 x 1920 pixels; a breast of plausible values with noise of 14 bits. Every encoding runs in a fresh process that
holds the arrays before the measurement begins. --extra: with all objects on request. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from simcore import dicom
from simcore.core import memory
from simcore.core.artifacts import Compression, Phantom, ProjectionStack, Volume
from simcore.core.grid import Grid
from simcore.projection import AcquisitionSpec, PhysicsSpec, attenuation_per_mm, geometry_of

EXTRAS = ["presentation", "synthetic-2d", "ct", "attenuation", "report"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slices", type=int, default=60)
    parser.add_argument("--views", type=int, default=15)
    parser.add_argument("--extra", action="store_true")
    args = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    result = {}
    for encoding in ("none", "jpeg-ls", "rle"):
        with context.Pool(1) as pool:
            result[encoding] = pool.apply(measured, (encoding, args.slices, args.views, EXTRAS if args.extra else []))
        print(encoding, result[encoding])
    print(json.dumps(result))
    return 0


def measured(encoding: str, slices: int, views: int, extras: list[str]) -> dict[str, float]:
    """One export; the second one, when all code is compiled."""
    case = arguments(encoding, slices, views, extras)
    with tempfile.TemporaryDirectory(dir=".") as folder:
        dicom.export(Path(folder), *arguments(encoding, 2, 2, extras))
    with tempfile.TemporaryDirectory(dir=".") as folder:
        memory.reset_peak()
        before = memory.peak_bytes()
        start = time.perf_counter()
        dicom.export(Path(folder), *case)
        seconds = time.perf_counter() - start
        peak = memory.peak_bytes()
        written = sum(f.stat().st_size for f in Path(folder).rglob("*") if f.is_file())
    pixels = case[2].data.nbytes + case[3].data.nbytes
    return {
        "seconds": round(seconds, 2),
        "arrays_MB": round(pixels / 1e6),
        "written_MB": round(written / 1e6),
        "beyond_arrays_MB": round((peak - before) / 1e6),
    }


def arguments(encoding: str, slices: int, views: int, extras: list[str]) -> tuple[Any, ...]:
    """Specification, description, projections, volume, phantom and compression of a case made by hand."""
    geometry = geometry_of(AcquisitionSpec(views=views))
    ny, nx = geometry.detector.ny, geometry.detector.nx
    random = np.random.default_rng(1)
    y, x = np.mgrid[-ny / 2 : ny / 2, 0:nx] * 0.1
    inside = np.maximum(1 - (x / 110) ** 2 - (y / 100) ** 2, 0)
    noise = random.normal(0, 40, (ny, nx))
    signal = 60000 * np.exp(-3 * np.sqrt(inside)) + noise
    stack = np.stack([np.roll(np.clip(signal, 1, 65535), 3 * k, axis=0).astype(np.uint16) for k in range(views)])
    grid = Grid((slices, ny, nx), (0.1, 0.1, 1.0), (0.0, -ny * 0.05, 20.0))
    plane = np.where(inside > 0, 25000 + 4 * noise, 20000)
    volume = np.empty(grid.shape, np.uint16)
    for k in range(slices):
        volume[k] = np.roll(plane, 5 * k, axis=0)
    coarse = Grid((slices, ny // 2, nx // 2), (0.2, 0.2, 1.0), (0.0, -ny * 0.05, 0.0))
    labels = np.broadcast_to((inside[::2, ::2] > 0).astype(np.uint8), coarse.shape).copy()
    labels[slices // 2 - 1 : slices // 2 + 1, 500:550, 300:350] = 5
    return (
        dicom.ExportSpec.model_validate({"encoding": encoding, "extra_objects": extras}),
        dicom.CaseDescription("00" * 32, 1, "0", 20.0, attenuation_per_mm=attenuation_per_mm(PhysicsSpec())),
        ProjectionStack(stack, 60000.0, geometry),
        Volume(volume, grid, 1e-5, -0.2),
        Phantom(labels, coarse),
        Compression(np.zeros((1, 3)), (0.0, float(slices)), 100.0, "converged"),
    )


if __name__ == "__main__":
    raise SystemExit(main())
