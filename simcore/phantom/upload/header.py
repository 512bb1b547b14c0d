"""What the header of a label volume says, whatever its format."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SpecError
from simcore.phantom.upload.spec import OWN_AXES, Axes

Encoding = Literal["raw", "gzip", "zlib", "bzip2"]

MAX_EDGE_VOXELS = 20_000
MAX_VOXELS = 2**34
"""Voxels of a volume that is read; more is taken for a broken header."""
MAX_HEADER_BYTES = 65536


@dataclass(frozen=True)
class Header:
    """Where the voxels are and what they are.

    format:     "nrrd", "metaimage" or "nifti".
    shape:      voxels along the axes of the array, slowest first.
    spacing_mm: voxel edges along the same axes; None where the file does not say.
    axes:       where each axis leads, as in UploadedPhantom.
    dtype:      integer type with its byte order.
    encoding:   of the voxels.
    offset:     bytes before the voxels, in the file or, where ``whole_gzip``, in what the file unpacks to.
    whole_gzip: whether the whole file is gzip-compressed.
    """

    format: str
    shape: tuple[int, int, int]
    spacing_mm: tuple[float, float, float] | None
    axes: Axes
    dtype: np.dtype[np.integer]
    encoding: Encoding
    offset: int
    whole_gzip: bool = False

    @property
    def voxel_bytes(self) -> int:
        """Size of the voxels once unpacked, bytes."""
        a, b, c = self.shape
        return a * b * c * self.dtype.itemsize


def refuse(message: str, code: str = "invalid-upload") -> SpecError:
    """The error of a file that cannot be read."""
    return SpecError(f"the label volume cannot be read: {message}", code=code)


def checked_shape(sizes: list[int]) -> tuple[int, int, int]:
    """Sizes of an array, fastest axis first, as a shape; a fourth axis of one entry is dropped.

    raises: SpecError where they are no volume, or one beyond all measure.
    """
    while len(sizes) > 3 and sizes[-1] == 1:
        sizes = sizes[:-1]
    if len(sizes) != 3:
        raise refuse(f"it has {len(sizes)} axes ({' x '.join(map(str, sizes))}); a volume has 3")
    if any(n < 1 or n > MAX_EDGE_VOXELS for n in sizes) or np.prod(sizes, dtype=object) > MAX_VOXELS:
        raise refuse(
            f"{' x '.join(map(str, sizes))} voxels; from 1 to {MAX_EDGE_VOXELS} along an axis, {MAX_VOXELS} in all"
        )
    return sizes[2], sizes[1], sizes[0]


def checked_spacing(edges: list[float]) -> tuple[float, float, float]:
    """Voxel edges, fastest axis first, as those along the axes of the array."""
    a, b, c = (abs(e) for e in edges[:3])
    if not all(np.isfinite(e) and e > 0 for e in (a, b, c)):
        raise refuse(f"voxel edges of {a:g} x {b:g} x {c:g} mm; all must be above 0")
    return c, b, a


def axes_of(directions: NDArray[np.float64], frame: str) -> Axes:
    """The array axes from their directions in a frame of the patient.

    directions: (3, 3), one row an axis, fastest first. frame: what its coordinates grow towards, of "LPS", "RAS",
        "LAS": +x of tomosim is anterior, +y left, +z superior, as a breast in the cranio-caudal view.
    returns: the axes, slowest first. raises: SpecError for an oblique volume.
    """
    ours = {"A": "+x", "P": "-x", "L": "+y", "R": "-y", "S": "+z", "I": "-z"}
    found = []
    for row in directions:
        length = float(np.linalg.norm(row))
        along = int(np.argmax(np.abs(row)))
        if not np.isfinite(length) or length == 0 or abs(row[along]) < 0.999 * length:
            raise refuse("its axes are not parallel to those of the patient: resample it, or remove its orientation")
        axis = ours[frame[along]]
        found.append(axis if row[along] > 0 else {"+": "-", "-": "+"}[axis[0]] + axis[1])
    if len({axis[1] for axis in found}) != 3:
        raise refuse("two of its axes have the same direction")
    x, y, z = found
    return (z, y, x)  # type: ignore[return-value]


def axes_or_own(directions: NDArray[np.float64], frame: str) -> Axes:
    """As ``axes_of``; but a unit matrix is what programs write that know no orientation: then the axes are ours."""
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    if np.all(lengths > 0) and np.allclose(directions / lengths, np.eye(3), atol=1e-6):
        return OWN_AXES
    return axes_of(directions, frame)


def number(text: str, name: str) -> float:
    """A number of a header. raises: SpecError naming the field"""
    try:
        value = float(text)
    except ValueError:
        raise refuse(f"{name} = {text[:40]!r} is no number") from None
    if not np.isfinite(value):
        raise refuse(f"{name} = {text[:40]!r} is no finite number")
    return value


def whole_number(text: str, name: str) -> int:
    """A whole number of a header. raises: SpecError naming the field"""
    value = number(text, name)
    if value != int(value):
        raise refuse(f"{name} = {text[:40]!r} is no whole number")
    return int(value)
