"""What the header of a label volume says, whatever its format."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

import numpy as np

from simcore.core.errors import SpecError
from simcore.phantom.upload.spec import MAX_EDGE_MM, MIN_EDGE_MM, Axes

Encoding = Literal["raw", "gzip", "zlib", "bzip2"]
Edges = tuple[float, float, float]

MAX_EDGE_VOXELS = 20_000
MAX_VOXELS = 2**34
"""Voxels of a volume that is read; more is taken for a broken header."""
HEAD_BYTES = 65536
"""First bytes of a file, which hold most headers."""
MAX_HEADER_BYTES = 2**24
MAX_FIELD = 4096
"""Characters of a field that is read; comments may be longer."""

_T = TypeVar("_T")


@dataclass(frozen=True)
class Header:
    """Where the voxels are and what they are.

    format:     "nrrd", "metaimage" or "nifti".
    shape:      voxels along the axes of the array, slowest first.
    spacing_mm: voxel edges along the same axes; None where the file does not say.
    axes:       where each axis of the array leads, as in UploadedPhantom; None where that is not to be had.
    dtype:      type of a stored value with its byte order.
    encoding:   of the voxels.
    offset:     bytes before the voxels, in the file or, where ``whole_gzip``, in what the file unpacks to.
    whole_gzip: whether the whole file is gzip-compressed.
    lines:      lines between ``offset`` and the voxels, packed or not.
    skip:       further bytes before the voxels, once unpacked; -1: the voxels are the last bytes of the file.
    slope, intercept: a label is slope * stored value + intercept.
    problems:   why ``spacing_mm`` or ``axes`` is None, by that name, where the file says something of no use.
    remarks:    what to tell of a file that is read all the same.
    """

    format: str
    shape: tuple[int, int, int]
    spacing_mm: Edges | None
    axes: Axes | None
    dtype: np.dtype[Any]
    encoding: Encoding
    offset: int
    whole_gzip: bool = False
    lines: int = 0
    skip: int = 0
    slope: float = 1.0
    intercept: float = 0.0
    problems: dict[str, SpecError] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def voxel_bytes(self) -> int:
        """Size of the voxels once unpacked, bytes."""
        a, b, c = self.shape
        return a * b * c * self.dtype.itemsize

    def placed(self, spacing_mm: Edges | None = None, axes: Axes | None = None) -> tuple[Edges, Axes]:
        """Voxel edges and axes: those that are given, else those of the file. raises: SpecError where there are none"""
        spacing_mm, axes = spacing_mm or self.spacing_mm, axes or self.axes
        if spacing_mm is None:
            raise self.problems.get("spacing_mm") or refuse(
                "its header has no voxel size: give spacing_mm (--spacing-mm A,B,C: mm, slowest axis first)"
            )
        if axes is None:
            raise self.problems["axes"]
        return spacing_mm, axes


_NOT_READ = "the label volume cannot be read: "


def refuse(message: str, code: str = "invalid-upload") -> SpecError:
    """The error of a file that cannot be read."""
    return SpecError(_NOT_READ + message, code=code)


def reason(error: SpecError) -> str:
    """What ``refuse`` was given."""
    return str(error).removeprefix(_NOT_READ)


def attempt(problems: dict[str, SpecError], name: str, read: Callable[[], _T]) -> _T | None:
    """What ``read`` gives; None where it raises a SpecError, which is kept: another value may be given instead."""
    try:
        return read()
    except SpecError as error:
        problems[name] = error
        return None


def checked_shape(sizes: list[int], spacing_mm: Edges | None = None) -> tuple[int, int, int]:
    """Sizes of three axes, fastest first, as a shape.

    spacing_mm: along the axes of the array, slowest first, to say which would do.
    raises: SpecError where they are no volume, or one beyond all measure.
    """
    if len(sizes) != 3:
        raise refuse(f"it has {len(sizes)} axes ({' x '.join(map(str, sizes))}); a volume has 3")
    named = f"{' x '.join(map(str, sizes))} voxels; from 1 to {MAX_EDGE_VOXELS} along an axis, {MAX_VOXELS} in all"
    if any(n < 1 for n in sizes):
        raise refuse(named)
    factor = max(max(sizes) / MAX_EDGE_VOXELS, (float(np.prod(sizes, dtype=object)) / MAX_VOXELS) ** (1 / 3))
    if factor > 1:
        raise refuse(f"{named}: cut it to the breast, or resample it to voxels of {_coarser(spacing_mm, factor)}")
    return sizes[2], sizes[1], sizes[0]


def _coarser(spacing_mm: Edges | None, factor: float) -> str:
    """Voxel edges that are larger by a factor, rounded up, in words."""
    if spacing_mm is None:
        return f"{np.ceil(factor * 100) / 100:g} times the edge"
    edges = [np.ceil(edge * factor * 1000) / 1000 for edge in reversed(spacing_mm)]
    return " x ".join(f"{edge:g}" for edge in edges) + " mm"


def checked_spacing(edges: list[float], name: str) -> Edges:
    """Voxel edges in mm, fastest axis first, as those along the axes of the array. raises: SpecError"""
    a, b, c = edges
    shown = f"{name}: voxel edges of {a:g} x {b:g} x {c:g} mm"
    remedy = "give spacing_mm (--spacing-mm A,B,C: mm, slowest axis first)"
    if not all(np.isfinite(e) and e > 0 for e in edges):
        raise refuse(
            f"{shown}; all must be above 0: {remedy}, and where an axis runs the other way axes (such as -z,+y,+x)"
        )
    if not all(MIN_EDGE_MM <= e <= MAX_EDGE_MM for e in edges):
        scales = {"m": 1000.0, "cm": 10.0, "um": 1e-3}
        units = [u for u, s in scales.items() if all(MIN_EDGE_MM <= e * s <= MAX_EDGE_MM for e in edges)]
        guess = f" (are they in {' or '.join(units)}?)" if units else ""
        raise refuse(f"{shown}; from {MIN_EDGE_MM:g} to {MAX_EDGE_MM:g} mm{guess}: {remedy}, or resample the volume")
    return round(c, 9), round(b, 9), round(a, 9)


def check_fields(entries: dict[str, str], names: Iterable[str]) -> None:
    """raises: SpecError where one of the fields is longer than MAX_FIELD"""
    for name in names:
        if len(entries.get(name, "")) > MAX_FIELD:
            raise refuse(f"its field {name!r} has {len(entries[name])} characters; at most {MAX_FIELD}")


def number(text: str, name: str) -> float:
    """A number of a header. raises: SpecError naming the field"""
    try:
        value = float(text)
    except ValueError:
        raise refuse(f"{name} = {text[:40]!r} is no number (such as 0.2, with a point)") from None
    if not np.isfinite(value):
        raise refuse(f"{name} = {text[:40]!r} is no finite number")
    return value


def whole_number(text: str, name: str) -> int:
    """A whole number of a header. raises: SpecError naming the field"""
    value = number(text, name)
    if value != int(value):
        raise refuse(f"{name} = {text[:40]!r} is no whole number")
    return int(value)
