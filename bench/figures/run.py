"""Figures 5 and 6 of the paper and its section 5.4, more views, more contrast, fewer artefacts.

    python -m bench.figures [--data DIR]

Runs the paper's cup C at 20 and 50 % (stages that the store of DIR has are not computed again), projects and
reconstructs the compressed breasts with all the paper's acquisitions, and writes docs/figures.md and
docs/images/figure5.png, figure6.png, figure6_detail.png, figure_views.png. Last line: one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.figures import insertion, resolution
from bench.figures import views as drawn
from bench.figures.page import page
from bench.support.panels import grey, resized, save_panels
from simcore import pipeline, presets, projection
from simcore.core.artifacts import Phantom
from simcore.presets import PAPER_ACQUISITIONS, paper_case
from simcore.projection.spec import AcquisitionSpec, PhysicsSpec
from simcore.reconstruction.spec import FilteredBackprojection
from simcore.store import codecs
from simcore.store.hashing import FileRef
from simcore.store.store import Store

DOCS = Path(__file__).parents[2] / "docs"
IMAGES = DOCS / "images"
TUBE_ANGLES = (-20, -10, 0, 10, 20)
VIEWS = (7, 11, 13, 15, 30)
RANGES = (20, 30, 40)
SLICE_MM = 0.38
"""Pixels of the slices drawn."""
DETAIL_MM = 36.0
DETAIL_PIXEL_MM = 0.15
"""Edge and pixels of the detail of a slice."""

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Breast:
    """A compressed breast: labels in the support frame, distance of the plates in mm."""

    labels: Phantom
    thickness: float

    @classmethod
    def of(cls, preset: str, store: Store) -> Breast:
        """Through the pipeline, or from the store where it has been there."""
        manifest = pipeline.run(
            presets.get(preset), store, lambda stage, fraction, message, cached=False: tell(preset, stage, fraction)
        ).manifest
        outputs = next(s["outputs"] for s in manifest["stages"] if s["name"] == "warp")
        warped = codecs.load_phantom(lambda name: store.path(FileRef(**outputs[name])))
        return cls(warped, manifest["results"]["thickness_mm"])

    def slice(self, acquisition: AcquisitionSpec) -> Image:
        """The reconstructed slice at mid height, 1/mm, (ny, nx) of detector pixels."""
        stack = projection.project(self.labels, acquisition, PhysicsSpec())
        z = acquisition.air_gap_mm + self.thickness / 2
        volume = insertion.slab(stack, FilteredBackprojection(), z - 0.5, z + 0.5)
        return np.asarray(insertion.attenuation(volume)[0])


def tell(*words: object) -> None:
    print(*words, file=sys.stderr, flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder of the store (default: one that is removed at the end)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=".") as folder:
        store = Store((args.data or Path(folder)) / "store")
        soft, hard = Breast.of("paper-cup-c-20-40x15", store), Breast.of("paper-cup-c-50", store)
    figure_5(soft)
    slices = {(r, v): soft.slice(acquisition(r, v)) for r, v in PAPER_ACQUISITIONS if r == 40 or v == 15}
    figure_6(slices, hard.slice(acquisition(40, 15)))
    del slices
    objects = insertion.choose(soft.labels)
    outcomes = []
    for angular_range, views in PAPER_ACQUISITIONS:
        tell("objects", f"{angular_range}°/{views}")
        outcomes.append(insertion.measure(soft.labels, objects, acquisition(angular_range, views), PhysicsSpec()))
    drawn.draw(outcomes, IMAGES / "figure_views.png")
    edge = resolution.detector_edge()
    beads = {f"{r}°/15": resolution.slice_beads(acquisition(r, 15)) for r in RANGES}
    (DOCS / "figures.md").write_text(page(outcomes, objects, edge, beads))
    print(json.dumps({"acquisitions": [o.to_dict() for o in outcomes], "edge": edge, "beads": beads}))
    return 0


def acquisition(angular_range: float, views: int) -> AcquisitionSpec:
    return paper_case("c", 20, angular_range, views).acquisition


def figure_5(breast: Breast) -> None:
    """Projections at five tube angles: the whole height of the detector, so that the shadow is seen to move."""
    stack = projection.project(breast.labels, acquisition(40, len(TUBE_ANGLES)), PhysicsSpec())
    integrals = np.log(stack.open_field / np.maximum(stack.data, 1)).astype(np.float32)
    lit = int(np.flatnonzero((integrals > 0).any(axis=(0, 1)))[-1]) + 60
    window = (0.15 * float(integrals.max()), 0.97 * float(integrals.max()))
    pixel = stack.geometry.detector.pixel
    panels = [
        (f"{angle:+d}°" if angle else "0°", grey(resized(view[:, :lit], pixel, 0.4), window))
        for angle, view in zip(TUBE_ANGLES, integrals, strict=True)
    ]
    save_panels([panels], IMAGES / "figure5.png")


def figure_6(slices: dict[tuple[int, int], Image], hard: Image) -> None:
    """Slices of more and more views, then 50 %; a detail by number of views, and one by angular range."""
    pixel = acquisition(40, 15).detector.pixel_mm
    best = slices[40, 30]
    window = window_of(best)
    panels = [
        (f"40°/{views} (20 %)", grey(resized(slices[40, views][extent(best)], pixel, SLICE_MM), window))
        for views in VIEWS
    ]
    panels.append(("40°/15 (50 %)", grey(resized(hard[extent(hard)], pixel, SLICE_MM), window_of(hard))))
    save_panels([panels[:3], panels[3:]], IMAGES / "figure6.png")

    side = round(DETAIL_MM / pixel)
    corner = ((best.shape[0] - side) // 2, round(30.0 / pixel))

    def detail(image: Image) -> NDArray[np.uint8]:
        cut = image[corner[0] : corner[0] + side, corner[1] : corner[1] + side]
        return grey(resized(cut, pixel, DETAIL_PIXEL_MM), window)

    rows = [
        [(f"40°/{views}", detail(slices[40, views])) for views in (7, 15, 30)],
        [(f"{r}°/15", detail(slices[r, 15])) for r in RANGES],
    ]
    save_panels(rows, IMAGES / "figure6_detail.png")


def extent(image: Image) -> tuple[slice, slice]:
    """Rows and columns of the breast in a slice, with a margin, symmetrical about the middle row."""
    bright = image > 0.5 * float(np.percentile(image[image > 0], 99))
    middle, margin = image.shape[0] // 2, 40
    rows = np.flatnonzero(bright.any(axis=1))
    half = min(middle, int(max(rows[-1] - middle, middle - rows[0])) + margin)
    return slice(middle - half, middle + half), slice(0, int(np.flatnonzero(bright.any(axis=0))[-1]) + margin)


def window_of(image: Image) -> tuple[float, float]:
    """Air a little above black; all of the breast but skin and ligaments below white."""
    inside = image[image > 0.25 * float(np.percentile(image, 99.5))]
    high = 1.1 * float(np.percentile(inside, 97))
    return -0.05 * high, high
