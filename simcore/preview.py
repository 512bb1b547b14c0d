"""Pictures of a case for people: small PNG files, never for measuring.

Orientation of all: chest wall (x = 0) on the left, nipple on the right; y upright with -y on top, as rows are stored,
or, in sections across y, z upright with the source on top. Equal input gives equal bytes.
"""

from __future__ import annotations

import zlib
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from simcore.core.artifacts import Phantom, ProjectionStack, Volume
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.kernels import njit

MAX_PIXELS = 1024
"""Longest side of a picture of one image, pixels."""
GAP = 8
"""Distance of the images of a sheet, pixels."""
MAX_EXACT = 256
"""The sum of so many 16-bit numbers is a float32 without rounding."""

Window = tuple[float, float]
Grey = NDArray[np.uint8]

TISSUE_GREY: dict[Tissue, int] = {
    Tissue.AIR: 0,
    Tissue.ADIPOSE: 90,
    Tissue.GLAND: 185,
    Tissue.SKIN: 150,
    Tissue.LIGAMENT: 125,
    Tissue.MASS: 225,
    Tissue.CALCIFICATION: 255,
    Tissue.MUSCLE: 165,
    Tissue.NIPPLE: 160,
    Tissue.DUCT: 205,
    Tissue.TDLU: 195,
    Tissue.ARTERY: 175,
    Tissue.VEIN: 170,
}
"""Grey value of each tissue, as in the sections of the phantom's publications: the denser, the brighter."""


def phantom_png(labels_slice: NDArray[np.uint8], path: Path) -> None:
    """A picture of labels, uint8 (rows, columns), in the grey values of TISSUE_GREY."""
    _save(_label_picture(labels_slice), path)


def image_png(image: NDArray[Any], path: Path, window: Window | None = None) -> None:
    """A picture of values (rows, columns), linear from black at window[0] to white at window[1].

    window: the 1st to 99.5th percentile of the image where not given.
    """
    _save(_picture(image, window or percentile_window(image)), path)


def write_previews(
    folder: Path,
    phantom: Phantom | None = None,
    compressed: Phantom | None = None,
    stack: ProjectionStack | None = None,
    volume: Volume | None = None,
) -> list[str]:
    """Writes pictures of what is given into ``folder``/preview.

    phantom.png, compressed.png: middle section across z and middle section across y, side by side, same scale.
    projection_01.png ...: every view, -log of the signal (breast bright); projections.png: first, quarter, middle,
    three-quarter and last view with one window. volume.png: the middle slice; volume_slices.png: four slices.
    returns: the names written, relative to ``folder``.
    """
    pictures: dict[str, Grey] = {}
    for name, labels in (("phantom", phantom), ("compressed", compressed)):
        if labels is not None:
            pictures[name] = _phantom_picture(labels)
    if stack is not None:
        pictures.update(_projection_pictures(stack))
    if volume is not None:
        pictures.update(_volume_pictures(volume))
    names = []
    for name, picture in pictures.items():
        _save(picture, folder / "preview" / f"{name}.png")
        names.append(f"preview/{name}.png")
    return names


def percentile_window(values: NDArray[Any], low: float = 1.0, high: float = 99.5) -> Window:
    """Window from percentiles of the values; never of no width."""
    if values.size == 0:
        return 0.0, 1.0
    bottom, top = (float(v) for v in np.percentile(values, (low, high)))
    return bottom, max(top, float(np.nextafter(np.float32(bottom), np.float32(np.inf))))


def _phantom_picture(phantom: Phantom) -> Grey:
    """Middle section across z beside the middle section across y, both with square pixels of one size."""
    nz, ny, _ = phantom.labels.shape
    dx, dy, dz = phantom.grid.spacing
    stride = max(1, ceil(max(phantom.labels.shape) / MAX_PIXELS))
    across_z = _label_picture(phantom.labels[nz // 2], stride)
    across_y = _label_picture(phantom.labels[::-1, ny // 2], stride)
    pixel = min(dx, dy, dz)
    return _side_by_side([_stretched(across_z, dx / pixel, dy / pixel), _stretched(across_y, dx / pixel, dz / pixel)])


def _projection_pictures(stack: ProjectionStack) -> dict[str, Grey]:
    factor = _reduction(stack.data.shape[1:])
    views = [_line_integrals(_reduced(view, factor), stack.background) for view in stack.data]
    windows = [_window_inside(view) for view in views]
    pictures = {f"projection_{k + 1:02d}": _grey(views[k], windows[k]) for k in range(len(views))}
    last = len(views) - 1
    shown = [round(last * quarter / 4) for quarter in range(5)]
    common = windows[shown[2]]
    sheet = [_grey(_reduced(views[k], 2), common) for k in dict.fromkeys(shown)]
    return {**pictures, "projections": _side_by_side(sheet)}


def _line_integrals(signal: NDArray[np.float32], open_field: float) -> NDArray[np.float32]:
    return np.asarray(np.log(open_field / np.maximum(signal, 1.0)), np.float32)


def _window_inside(line_integrals: NDArray[np.float32]) -> Window:
    """Window of what lies in the breast: where there is some attenuation, and not the thin rim."""
    rim = 0.05 * float(line_integrals.max(initial=0.0))
    _, top = percentile_window(line_integrals[line_integrals > rim], 1.0, 99.8)
    bottom, _ = percentile_window(line_integrals[line_integrals > 4 * rim], 1.0, 99.8)
    return min(0.5 * bottom, 0.5 * top), top


def _volume_pictures(volume: Volume) -> dict[str, Grey]:
    nz = volume.data.shape[0]
    factor = _reduction(volume.data.shape[1:])

    def attenuation(z: int) -> NDArray[np.float32]:
        return np.float32(volume.slope) * _reduced(volume.data[z], factor) + np.float32(volume.intercept)

    middle = attenuation(nz // 2)
    inside = middle[middle > 0.05 * float(middle.max(initial=0.0))]
    window = (0.0, percentile_window(inside, 1.0, 99.5)[1])
    shown = dict.fromkeys(round((nz - 1) * part) for part in (0.2, 0.4, 0.6, 0.8))
    sheet = [_grey(_reduced(attenuation(z), 2), window) for z in shown]
    return {"volume": _grey(middle, window), "volume_slices": _side_by_side(sheet)}


def _picture(image: NDArray[Any], window: Window) -> Grey:
    return _grey(_reduced(image, _reduction(image.shape)), window)


def _label_picture(labels: NDArray[np.uint8], stride: int | None = None) -> Grey:
    """Every stride-th label (labels are not averaged), as grey values."""
    table = np.zeros(MAX_TISSUES, np.uint8)
    for tissue, grey in TISSUE_GREY.items():
        table[tissue] = grey
    stride = _reduction(labels.shape) if stride is None else stride
    return np.asarray(table[labels[stride // 2 :: stride, stride // 2 :: stride]])


def _reduction(shape: tuple[int, ...]) -> int:
    return max(1, ceil(max(shape) / MAX_PIXELS))


def _reduced(image: NDArray[Any], factor: int) -> NDArray[np.float32]:
    """Means over factor x factor pixels; a remainder at the far edges is left out."""
    down, across = min(factor, image.shape[0]), min(factor, image.shape[1])
    rows, columns = image.shape[0] // down, image.shape[1] // across
    image = image[: rows * down, : columns * across]
    if image.dtype == np.uint16 and down * across <= MAX_EXACT:
        # Sums of whole numbers that float32 holds exactly: the mean in it, many times faster.
        return np.asarray(_sums(np.asarray(image), down, across).astype(np.float32) / np.float32(down * across))
    blocks = image.reshape(rows, down, columns, across)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))


@njit(cache=True, nogil=True)
def _sums(image: NDArray[np.uint16], down: int, across: int) -> NDArray[np.uint32]:
    """Sums over blocks of pixels; the blocks fill the image."""
    rows, columns = image.shape[0] // down, image.shape[1] // across
    sums = np.zeros((rows, columns), np.uint32)
    for row in range(image.shape[0]):
        for column in range(columns):
            block = np.uint32(0)
            for k in range(across):
                block += image[row, column * across + k]
            sums[row // down, column] += block
    return sums


def _grey(image: NDArray[Any], window: Window) -> Grey:
    bottom, top = window
    scaled = (np.asarray(image, np.float32) - np.float32(bottom)) * np.float32(255.0 / (top - bottom))
    return np.asarray(np.rint(np.clip(scaled, 0.0, 255.0)), np.uint8)


def _stretched(picture: Grey, along_columns: float, along_rows: float) -> Grey:
    """Repeats pixels where voxels are not cubes."""
    rows = np.arange(round(picture.shape[0] * along_rows)) / along_rows
    columns = np.arange(round(picture.shape[1] * along_columns)) / along_columns
    return np.asarray(picture[np.ix_(rows.astype(int), columns.astype(int))])


def _side_by_side(pictures: list[Grey]) -> Grey:
    height = max(p.shape[0] for p in pictures)
    width = sum(p.shape[1] for p in pictures) + GAP * (len(pictures) - 1)
    sheet = np.full((height, width), 48, np.uint8)
    left = 0
    for picture in pictures:
        top = (height - picture.shape[0]) // 2
        sheet[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
        left += picture.shape[1] + GAP
    return sheet


def _save(picture: Grey, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    # Runs alone, no search for repeated strings: a third of the time, and on these pictures fewer bytes.
    Image.fromarray(np.ascontiguousarray(picture)).save(path, format="PNG", compress_level=6, compress_type=zlib.Z_RLE)
