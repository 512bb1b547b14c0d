"""NIfTI-1 and NIfTI-2 in one file (.nii, .nii.gz): nifti.nimh.nih.gov/pub/dist/src/niftilib/nifti1.h, nifti2.h."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SpecError
from simcore.phantom.upload.formats.header import Edges, Header, attempt, checked_shape, checked_spacing, refuse
from simcore.phantom.upload.formats.layers import volume_axes
from simcore.phantom.upload.formats.orientation import axes_of, nearest_axes
from simcore.phantom.upload.formats.units import mm_per
from simcore.phantom.upload.spec import OWN_AXES, Axes

_DTYPES = {
    2: "u1",
    4: "i2",
    8: "i4",
    16: "f4",
    64: "f8",
    256: "i1",
    512: "u2",
    768: "u4",
    1024: "i8",
    1280: "u8",
}
_COLOURS = {128: "RGB", 2304: "RGBA"}
_UNITS = {0: "", 1: "m", 2: "mm", 3: "um"}
LARGEST_OFFSET = 2**24
_SAME_LENGTH = 0.01


@dataclass(frozen=True)
class _Layout:
    """Where the fields of a version are: (struct format, byte)."""

    header_bytes: int
    magic: tuple[int, bytes, bytes]
    dim: tuple[str, int]
    datatype: tuple[str, int]
    pixdim: tuple[str, int]
    vox_offset: tuple[str, int]
    scaling: tuple[str, int]
    units: tuple[str, int]
    codes: tuple[str, int]
    quatern: tuple[str, int]
    srow: tuple[str, int]


_LAYOUTS = {
    348: _Layout(
        348, (344, b"n+1\0", b"ni1\0"), ("8h", 40), ("h", 70), ("8f", 76), ("f", 108), ("2f", 112), ("b", 123),
        ("2h", 252), ("3f", 256), ("12f", 280)
    ),
    540: _Layout(
        540, (4, b"n+2\0", b"ni2\0"), ("8q", 16), ("h", 12), ("8d", 104), ("q", 168), ("2d", 176), ("i", 500),
        ("2i", 344), ("3d", 352), ("12d", 400)
    ),
}  # fmt: skip


@dataclass(frozen=True)
class _Fields:
    head: bytes
    order: str
    layout: _Layout

    def get(self, name: str) -> tuple[Any, ...]:
        """The numbers of a field."""
        kind, at = getattr(self.layout, name)
        return struct.unpack_from(self.order + kind, self.head, at)


def looks_like(head: bytes) -> bool:
    """Whether the file begins with the size of its header, in either byte order."""
    return head[:4] in tuple(struct.pack(f"{order}i", n) for order in "<>" for n in _LAYOUTS)


def parse(head: bytes, whole_gzip: bool) -> Header:
    """The header in the first bytes of a file, unpacked. raises: SpecError"""
    fields = _fields(head)
    dim = fields.get("dim")
    if not 1 <= dim[0] <= 7:
        raise refuse(f"NIfTI dim[0] = {dim[0]}: 3")
    (code,) = fields.get("datatype")
    if code in _COLOURS:
        raise refuse(f"NIfTI datatype = {code} ({_COLOURS[code]}): one label a voxel is needed, no colours")
    if code not in _DTYPES:
        raise refuse(f"NIfTI datatype = {code}: labels are numbers ({', '.join(map(str, _DTYPES))})")
    sizes = list(dim[1 : dim[0] + 1])
    kept = volume_axes(sizes)
    slope, intercept = _scaling(fields)
    problems: dict[str, SpecError] = {}
    spacing = attempt(problems, "spacing_mm", partial(_spacing, fields, kept))
    axes = attempt(problems, "axes", partial(_axes, fields, kept))
    return Header(
        "nifti",
        checked_shape([sizes[k] for k in kept], spacing),
        spacing,
        axes[0] if axes else None,
        np.dtype(_DTYPES[code]).newbyteorder(fields.order),  # type: ignore[arg-type]
        "raw",
        _offset(fields),
        whole_gzip,
        slope=slope,
        intercept=intercept,
        problems=problems,
        remarks=axes[1] if axes else (),
    )


def _fields(head: bytes) -> _Fields:
    """raises: SpecError where it is no NIfTI in one file"""
    little = struct.unpack_from("<i", head)[0]
    order = "<" if little in _LAYOUTS else ">"
    layout = _LAYOUTS[struct.unpack_from(f"{order}i", head)[0]]
    if len(head) < layout.header_bytes:
        raise refuse("the NIfTI header is cut short", "upload-cut-short")
    at, one_file, _ = layout.magic
    if head[at : at + 4] != one_file:
        raise refuse(
            f"NIfTI magic is {head[at : at + 4]!r}, not {one_file!r}: voxels in a second file (.hdr and .img) are not "
            "read, save it as one .nii file"
        )
    return _Fields(head, order, layout)


def _offset(fields: _Fields) -> int:
    (offset,) = fields.get("vox_offset")
    least = fields.layout.header_bytes
    if not (least <= offset <= LARGEST_OFFSET and offset == int(offset)):
        raise refuse(f"NIfTI vox_offset = {offset:g}: from {least} to {LARGEST_OFFSET}")
    return int(offset)


def _scaling(fields: _Fields) -> tuple[float, float]:
    """Slope and intercept; a slope of 0 or NaN means none."""
    slope, intercept = fields.get("scaling")
    if math.isnan(slope) or slope == 0.0:
        return 1.0, 0.0
    if not (math.isfinite(slope) and math.isfinite(intercept)):
        raise refuse(f"NIfTI scl_slope = {slope:g}, scl_inter = {intercept:g}: finite, or 0 for none")
    if fields.layout.scaling[0] == "2f":  # 0.1 is stored as 0.100000001
        slope, intercept = (float(str(np.float32(n))) for n in (slope, intercept))
    return slope, intercept


def _spacing(fields: _Fields, kept: list[int]) -> Edges:
    """Voxel edges, mm. raises: SpecError where pixdim is of no use, or the sform says another size"""
    (code,) = fields.get("units")
    unit = _UNITS.get(code & 7)
    if unit is None:
        raise refuse(f"NIfTI xyzt_units = {code}: lengths in m, mm or um ({', '.join(map(str, _UNITS))})")
    length = mm_per(unit, "NIfTI xyzt_units")
    pixdim, directions = fields.get("pixdim"), _sform(fields)
    edges = [round(length * pixdim[k + 1], 6) for k in kept]  # float32
    if directions is not None:
        edges = [abs(edge) for edge in edges]  # an old way to say left or right, which the sform says
        norms = np.linalg.norm(directions, axis=1) * length
        if not np.allclose(norms, edges, rtol=_SAME_LENGTH):
            shown = " x ".join(f"{n:g}" for n in norms)
            raise refuse(
                f"NIfTI pixdim says voxels of {' x '.join(f'{e:g}' for e in edges)} mm, sform {shown} mm: give the "
                "right size as spacing_mm (--spacing-mm A,B,C: slowest axis first)"
            )
    return checked_spacing(edges, "NIfTI pixdim")


def _axes(fields: _Fields, kept: list[int]) -> tuple[Axes, tuple[str, ...]]:
    """Where the axes lead, and what to tell of it. raises: SpecError where that is not to be had"""
    sform, qform = _sform(fields), _qform(fields)
    if kept != [0, 1, 2] and (sform is not None or qform is not None):
        raise refuse("NIfTI with a first axis of one entry: its orientation is that of other axes; give axes")
    if sform is None:
        return (OWN_AXES, ()) if qform is None else axes_of(qform, "RAS")
    axes, remarks = axes_of(sform, "RAS")
    if qform is not None:
        other = nearest_axes(qform, "RAS")
        if other != axes:
            raise refuse(
                f"NIfTI sform leads its axes along {','.join(axes)}, qform along {','.join(other)} (slowest first): "
                f"give the right ones as axes (--axes {','.join(axes)})"
            )
    return axes, remarks


def _sform(fields: _Fields) -> NDArray[np.float64] | None:
    """Directions (3, 3) of the array axes in RAS, one row an axis, fastest first; None where the file has none."""
    if fields.get("codes")[1] <= 0:
        return None
    rows = np.array(fields.get("srow"), np.float64).reshape(3, 4)
    return np.ascontiguousarray(rows[:, :3].T)


def _qform(fields: _Fields) -> NDArray[np.float64] | None:
    """As ``_sform``, of unit length."""
    if fields.get("codes")[0] <= 0:
        return None
    b, c, d = fields.get("quatern")
    a = np.sqrt(max(0.0, 1.0 - b * b - c * c - d * d))
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    if fields.get("pixdim")[0] < 0:
        rotation[:, 2] *= -1
    return np.ascontiguousarray(rotation.T)
