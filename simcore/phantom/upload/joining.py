"""Header and voxels in two files become one file: only that has one digest, and knows by itself what it is."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import IO

from simcore.phantom.upload import metaimage, nrrd
from simcore.phantom.upload.decoding import PIECE, begins_with_gzip
from simcore.phantom.upload.header import MAX_HEADER_BYTES, Encoding, Header, refuse

_NRRD_TYPES = {"i1": "int8", "u1": "uint8", "i2": "int16", "u2": "uint16", "i4": "int32", "u4": "uint32"}


def two_files(path: Path) -> tuple[Path, Header] | None:
    """Where the voxels of a header file (.mhd, .nhdr) lie, and what they are; None for any other file.

    raises: SpecError where the header or the file it names is of no use.
    """
    suffix = path.suffix.lower()
    if suffix not in (".mhd", ".nhdr"):
        return None
    with open(path, "rb") as file:
        head = file.read(MAX_HEADER_BYTES)
    if suffix == ".mhd":
        found, _ = metaimage.tags(head)
        name, header = found[metaimage.LAST_TAG], metaimage.header_of(found, 0)
    else:
        if b"\n\n" not in head and b"\r\n\r\n" not in head:
            head += b"\n\n"  # a detached header may lack the empty line
        name = _data_file(head)
        kept = [line for line in head.splitlines() if line.partition(b":")[0].strip().lower() not in _DATA_FILE]
        header = nrrd.parse(b"\n".join(kept) + b"\n\n")
    if name.upper() in ("LOCAL", "LIST") or "%" in name or len(name.split()) > 1:
        raise refuse(f"{path.name} names {name[:80]!r} as the file of its voxels: one file is needed")
    voxels = path.parent / Path(name).name
    if not voxels.is_file():
        raise refuse(f"{path.name} names {name[:80]!r} as the file of its voxels, which is not beside it")
    with open(voxels, "rb") as file:
        encoding: Encoding = "gzip" if begins_with_gzip(file) else header.encoding
    return voxels, Header("raw", header.shape, header.spacing_mm, header.axes, header.dtype, encoding, 0)


_DATA_FILE = (b"data file", b"datafile")


def _data_file(head: bytes) -> str:
    found, _ = nrrd.fields(head)
    name = found.get("data file", found.get("datafile"))
    if name is None:
        raise refuse("the .nhdr header names no data file")
    return name


def join(header: Header, voxels: IO[bytes], target: IO[bytes]) -> None:
    """Writes one file with the voxels as they are, packed or not: NRRD, or MetaImage for zlib, which NRRD lacks."""
    target.write(_metaimage(header) if header.encoding == "zlib" else _nrrd(header))
    voxels.seek(header.offset)
    shutil.copyfileobj(voxels, target, PIECE)


def _nrrd(header: Header) -> bytes:
    lines = [
        "NRRD0004",
        f"type: {_NRRD_TYPES[header.dtype.str[1:]]}",
        "dimension: 3",
        f"sizes: {_fastest_first(header.shape)}",
        f"encoding: {header.encoding}",
    ]
    if header.dtype.itemsize > 1:
        lines.append(f"endian: {'big' if _big_endian(header) else 'little'}")
    if header.spacing_mm is not None:
        lines.append(f"spacings: {_fastest_first(header.spacing_mm)}")
    return ("\n".join(lines) + "\n\n").encode()


def _metaimage(header: Header) -> bytes:
    kind = {"i1": "CHAR", "u1": "UCHAR", "i2": "SHORT", "u2": "USHORT", "i4": "INT", "u4": "UINT"}[header.dtype.str[1:]]
    lines = ["ObjectType = Image", "NDims = 3", "BinaryData = True", "CompressedData = True"]
    lines.append(f"BinaryDataByteOrderMSB = {_big_endian(header)}")
    lines.append(f"DimSize = {_fastest_first(header.shape)}")
    if header.spacing_mm is not None:
        lines.append(f"ElementSpacing = {_fastest_first(header.spacing_mm)}")
    lines += [f"ElementType = MET_{kind}", "ElementDataFile = LOCAL"]
    return ("\n".join(lines) + "\n").encode()


def _fastest_first(values: tuple[int, int, int] | tuple[float, float, float]) -> str:
    return " ".join(str(v) for v in reversed(values))


def _big_endian(header: Header) -> bool:
    return header.dtype.newbyteorder("=").str != header.dtype.str if header.dtype.itemsize > 1 else False
