"""Label volumes written by hand, in every format that is read."""

from __future__ import annotations

import bz2
import gzip
import struct
import zlib

import numpy as np

NRRD_TYPES = {"u1": "uchar", "i1": "int8", "u2": "unsigned short", "i2": "int16", "i4": "int", "u4": "uint32",
              "i8": "longlong", "u8": "uint64", "f4": "float", "f8": "double"}  # fmt: skip
MET_TYPES = {"u1": "UCHAR", "i1": "CHAR", "u2": "USHORT", "i2": "SHORT", "i4": "INT", "u4": "UINT",
             "i8": "LONG_LONG", "u8": "ULONG_LONG", "f4": "FLOAT", "f8": "DOUBLE"}  # fmt: skip
NIFTI_TYPES = {"u1": 2, "i2": 4, "i4": 8, "i1": 256, "u2": 512, "u4": 768,
               "i8": 1024, "u8": 1280, "f4": 16, "f8": 64}  # fmt: skip


def fast_first(values: tuple) -> str:
    return " ".join(str(v) for v in reversed(values))


def as_nrrd(labels: np.ndarray, spacing: tuple = (0.3, 0.2, 0.1), encoding: str = "gzip", more: str = "",
            without: str = "") -> bytes:  # fmt: skip
    lines = [
        "NRRD0005",
        "# made by hand",
        f"type: {NRRD_TYPES[labels.dtype.str[1:]]}",
        "dimension: 3",
        f"sizes: {fast_first(labels.shape)}",
        f"endian: {'big' if labels.dtype.str[0] == '>' else 'little'}",
        f"encoding: {encoding}",
        f"spacings: {fast_first(spacing)}",
        "name:=value that means nothing",
    ]
    lines = [line for line in lines if not (without and line.startswith(without))] + ([more] if more else [])
    packed = {"raw": bytes, "gzip": gzip.compress, "bzip2": bz2.compress}[encoding](labels.tobytes())
    return "\n".join(lines).encode() + b"\n\n" + packed


def as_metaimage(labels: np.ndarray, spacing: tuple = (0.3, 0.2, 0.1), packed: bool = True, more: str = "",
                 without: str = "", data_file: str = "LOCAL") -> bytes:  # fmt: skip
    lines = [
        "ObjectType = Image",
        "NDims = 3",
        "BinaryData = True",
        f"BinaryDataByteOrderMSB = {labels.dtype.str[0] == '>'}",
        f"CompressedData = {packed}",
        f"DimSize = {fast_first(labels.shape)}",
        "TransformMatrix = 1 0 0 0 1 0 0 0 1",
        "AnatomicalOrientation = RAI",
        f"ElementSpacing = {fast_first(spacing)}",
        f"ElementType = MET_{MET_TYPES[labels.dtype.str[1:]]}",
    ]
    lines = [line for line in lines if not (without and line.startswith(without))] + ([more] if more else [])
    data = zlib.compress(labels.tobytes()) if packed else labels.tobytes()
    return (
        "\n".join([*lines, f"ElementDataFile = {data_file}"]).encode() + b"\n" + (data if data_file == "LOCAL" else b"")
    )


def as_nifti(labels: np.ndarray, spacing: tuple = (0.3, 0.2, 0.1), packed: bool = True,
             affine: np.ndarray | None = None, quaternion: tuple | None = None, code: int | None = None,
             slope: float = 1.0, units: int = 2) -> bytes:  # fmt: skip
    order = ">" if labels.dtype.str[0] == ">" else "<"
    head = bytearray(352)
    struct.pack_into(f"{order}i", head, 0, 348)
    struct.pack_into(f"{order}8h", head, 40, 3, *reversed(labels.shape), 1, 1, 1, 1)
    struct.pack_into(f"{order}2h", head, 70, code or NIFTI_TYPES[labels.dtype.str[1:]], 8 * labels.itemsize)
    struct.pack_into(f"{order}8f", head, 76, 1.0, *reversed(spacing), 0, 0, 0, 0)
    struct.pack_into(f"{order}3f", head, 108, 352, slope, 0)
    head[123] = units
    if quaternion is not None:
        struct.pack_into(f"{order}2h", head, 252, 1, 0)
        struct.pack_into(f"{order}3f", head, 256, *quaternion)
    if affine is not None:
        struct.pack_into(f"{order}2h", head, 252, 0, 1)
        struct.pack_into(f"{order}12f", head, 280, *np.asarray(affine, float)[:3].ravel())
    head[344:348] = b"n+1\0"
    data = bytes(head) + labels.tobytes()
    return gzip.compress(data) if packed else data


def half_breast(dtype: str = "u1", voxel: float = 1.0) -> np.ndarray:
    """VICTRE labels (z, y, x) of a half ellipsoid, semi-axes 24 x 18 x 15 mm, chest wall at the first x with air
    before it: skin, fat, gland, a lesion."""
    z, y, x = np.meshgrid(np.arange(-17, 18, voxel), np.arange(-20, 21, voxel), np.arange(-3, 27, voxel), indexing="ij")
    radius = np.sqrt((x / 24) ** 2 + (y / 18) ** 2 + (z / 15) ** 2)
    labels = np.zeros(radius.shape, dtype)
    labels[radius <= 1] = 2
    labels[radius <= 0.92] = 1
    labels[radius <= 0.55] = 29
    labels[(x - 8) ** 2 + y**2 + z**2 <= 9] = 200
    labels[x < 0] = 0
    return labels
