"""The published rule of the challenge's reader (github.com/mazurowski-lab/duke-dbt-data), written again: pixels as
``dcmread_image`` gives them without their window, rows as ``read_boxes`` joins them, the pixels that a box holds.

The reader itself wants pandas before 1.5 and scikit-image; its arithmetic is what is written here.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pydicom
from numpy.typing import NDArray

KEY = ("PatientID", "StudyUID", "View")


def read_image(file: Path, view: str, index: int | None = None) -> NDArray[np.generic]:
    """The volume, or one slice of it, in the frame of the boxes: turned by 180 degrees where the brighter one of the
    first and the last column of a slice (the given one, else the first) is not at the side that the view names."""
    pixels = pydicom.dcmread(file).pixel_array
    slice_ = pixels[index or 0]
    side = "R" if int(slice_[:, 0].sum()) < int(slice_[:, -1].sum()) else "L"
    image = pixels if index is None else pixels[index]
    return image if side == view[0].upper() else np.flip(image, axis=(-1, -2))


def window(file: Path) -> tuple[float, float]:
    """Center and width, from the first item of the shared functional groups alone."""
    voi = pydicom.dcmread(file, stop_before_pixels=True)[0x5200, 0x9229][0][0x0028, 0x9132][0]
    return float(voi[0x0028, 0x1050].value), float(voi[0x0028, 0x1051].value)


def read_boxes(boxes: Path, paths: Path) -> list[dict[str, str]]:
    """Rows of the boxes, each with those of the file paths of the same patient, study and view."""
    with boxes.open(encoding="utf-8") as left, paths.open(encoding="utf-8") as right:
        files = list(csv.DictReader(right))
        return [
            {**row, **other}
            for row in csv.DictReader(left)
            for other in files
            if all(row[name] == other[name] for name in KEY)
        ]


def box_mask(shape: tuple[int, int], row: dict[str, str]) -> NDArray[np.bool_]:
    """Pixels that a box drawn on an image of (rows, columns) holds."""
    x, y, width, height = (int(row[name]) for name in ("X", "Y", "Width", "Height"))
    mask = np.zeros(shape, np.bool_)
    mask[y : y + height, x : x + width] = True
    return mask
