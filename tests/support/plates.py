"""A breast between plates, as a label volume that holds both."""

import numpy as np
from numpy.typing import NDArray

LOWER, UPPER = 18, 43
"""Planes across z: the first above the lower plate, and that behind the last below the upper one: 25 x 2 mm."""


def compressed(edge_zyx: tuple[float, float, float] = (2.0, 2.0, 2.0)) -> NDArray[np.uint8]:
    """A breast between two plates 50 mm apart, as VICTRE writes it: behind it, at the chest wall, a flange of muscle
    that is 88 mm high; the plates begin in front of it. (z, y, x)"""
    z, y, x = np.meshgrid(np.arange(61), np.arange(60), np.arange(45), indexing="ij")
    inside = ((x - 5) / 34.0) ** 2 + ((y - 29.5) / 26.0) ** 2 + ((z - 30) / 40.0) ** 2 <= 1
    labels = np.where(inside, 2, 0).astype(np.uint8)
    labels[((x - 5) / 33.0) ** 2 + ((y - 29.5) / 25.0) ** 2 + ((z - 30) / 39.0) ** 2 <= 1] = 1
    labels[((x - 5) / 22.0) ** 2 + ((y - 29.5) / 15.0) ** 2 + ((z - 30) / 30.0) ** 2 <= 1] = 29
    labels[:LOWER], labels[UPPER:] = 0, 0
    labels[(x < 5) & (np.abs(z - 30) <= 22) & (np.abs(y - 29.5) <= 27)] = 40
    plate = (x >= 5) & ((z == LOWER - 1) | (z == LOWER - 2) | (z == UPPER) | (z == UPPER + 1))
    labels[plate] = 50
    return labels


def nrrd(labels: NDArray[np.uint8], edge: float = 2.0) -> bytes:
    sizes = " ".join(map(str, reversed(labels.shape)))
    head = f"NRRD0004\ntype: uchar\ndimension: 3\nsizes: {sizes}\nencoding: raw\nspacings: {edge} {edge} {edge}\n\n"
    return head.encode() + labels.tobytes()
