"""NIfTI-1 in one file (.nii, .nii.gz): nifti.nimh.nih.gov/pub/dist/src/niftilib/nifti1.h."""

from __future__ import annotations

import struct
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simcore.phantom.upload.header import Header, axes_of, checked_shape, checked_spacing, refuse
from simcore.phantom.upload.spec import OWN_AXES

HEADER_BYTES = 348
_NIFTI_2_BYTES = 540
_DTYPES = {2: "u1", 4: "i2", 8: "i4", 256: "i1", 512: "u2", 768: "u4"}
_MM = {0: 1.0, 1: 1000.0, 2: 1.0, 3: 1e-3}
"""Length of a unit (unknown, metre, mm, micrometre), mm."""


def looks_like(head: bytes) -> bool:
    """Whether the file begins with the size of its header, in either byte order."""
    return head[:4] in tuple(struct.pack(f"{order}i", n) for order in "<>" for n in (HEADER_BYTES, _NIFTI_2_BYTES))


def parse(head: bytes, whole_gzip: bool) -> Header:
    """The header in the first bytes of a file, unpacked. raises: SpecError"""
    order: Literal["<", ">"] = "<" if struct.unpack_from("<i", head)[0] in (HEADER_BYTES, _NIFTI_2_BYTES) else ">"
    if struct.unpack_from(f"{order}i", head)[0] == _NIFTI_2_BYTES:
        raise refuse("it is NIfTI-2: save it as NIfTI-1")
    if len(head) < HEADER_BYTES:
        raise refuse("the NIfTI header is cut short")
    if head[344:348] != b"n+1\0":
        raise refuse("NIfTI magic is not 'n+1': voxels in a second file (.img) are not read, save it as one .nii file")
    dim = struct.unpack_from(f"{order}8h", head, 40)
    if not 1 <= dim[0] <= 7:
        raise refuse(f"NIfTI dim[0] = {dim[0]}: 3")
    (code,) = struct.unpack_from(f"{order}h", head, 70)
    if code not in _DTYPES:
        raise refuse(f"NIfTI datatype = {code}: labels are whole numbers ({', '.join(map(str, _DTYPES))})")
    pixdim = struct.unpack_from(f"{order}8f", head, 76)
    offset, slope, intercept = struct.unpack_from(f"{order}3f", head, 108)
    if slope not in (0.0, 1.0) or (slope == 1.0 and intercept != 0.0):
        raise refuse(f"NIfTI scl_slope = {slope:g}, scl_inter = {intercept:g}: labels must not be scaled")
    if not HEADER_BYTES <= offset <= 2**24 or offset != int(offset):
        raise refuse(f"NIfTI vox_offset = {offset:g}")
    unit = _MM.get(head[123] & 7)
    if unit is None:
        raise refuse(f"NIfTI xyzt_units = {head[123]}: lengths in mm")
    spacing = checked_spacing([round(unit * p, 6) for p in pixdim[1:4]])  # float32
    directions = _directions(head, order)
    axes = OWN_AXES if directions is None else axes_of(directions, "RAS")
    dtype = np.dtype(_DTYPES[code]).newbyteorder(order)
    return Header(
        "nifti", checked_shape(list(dim[1 : dim[0] + 1])), spacing, axes, dtype, "raw", int(offset), whole_gzip
    )


def _directions(head: bytes, order: str) -> NDArray[np.float64] | None:
    """Directions (3, 3) of the array axes in RAS, one row an axis, fastest first; None where the file has none."""
    qform, sform = struct.unpack_from(f"{order}2h", head, 252)
    if sform > 0:
        rows = np.array(struct.unpack_from(f"{order}12f", head, 280)).reshape(3, 4)
        return np.ascontiguousarray(rows[:, :3].T)
    if qform <= 0:
        return None
    b, c, d = struct.unpack_from(f"{order}3f", head, 256)
    a = np.sqrt(max(0.0, 1.0 - b * b - c * c - d * d))
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    if struct.unpack_from(f"{order}f", head, 76)[0] < 0:
        rotation[:, 2] *= -1
    return np.ascontiguousarray(rotation.T)
