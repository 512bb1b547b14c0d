"""NRRD with its voxels in the same file (teem.sourceforge.net/nrrd/format.html, versions 1 to 5)."""

from __future__ import annotations

import re

import numpy as np

from simcore.phantom.upload.header import (
    Encoding,
    Header,
    axes_or_own,
    checked_shape,
    checked_spacing,
    number,
    refuse,
    whole_number,
)
from simcore.phantom.upload.spec import OWN_AXES

MAGIC = b"NRRD000"

_TYPES = {
    "i1": ("signed char", "int8", "int8_t"),
    "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "i4": ("int", "signed int", "int32", "int32_t"),
    "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
}
_DTYPES = {name: dtype for dtype, names in _TYPES.items() for name in names}
_ENCODINGS: dict[str, Encoding] = {"raw": "raw", "gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2"}
_FRAMES = {
    "left-posterior-superior": "LPS",
    "lps": "LPS",
    "right-anterior-superior": "RAS",
    "ras": "RAS",
    "left-anterior-superior": "LAS",
    "las": "LAS",
}


def fields(head: bytes) -> tuple[dict[str, str], int]:
    """The fields of a header by their names in small letters, and where the voxels begin.

    raises: SpecError where the header does not end.
    """
    end = re.search(rb"\r?\n\r?\n", head)
    if end is None:
        raise refuse("the NRRD header has no end (an empty line)")
    found = {}
    for line in head[: end.start()].decode("latin-1").splitlines()[1:]:
        if line.startswith("#") or ":=" in line:
            continue
        name, colon, value = line.partition(":")
        if not colon:
            raise refuse(f"NRRD header line {line[:60]!r}")
        found[name.strip().lower()] = value.strip()
    return found, end.end()


def parse(head: bytes) -> Header:
    """The header in the first bytes of a file. raises: SpecError"""
    found, offset = fields(head)
    if "data file" in found or "datafile" in found:
        raise refuse("its voxels are in another file: add the .nhdr file where both lie, or put them into one file")
    kind = _field(found, "type").lower()
    if kind not in _DTYPES:
        raise refuse(f"NRRD type = {kind!r}: labels are whole numbers ({', '.join(sorted(_DTYPES))})")
    dtype = np.dtype(_DTYPES[kind])
    if dtype.itemsize > 1:
        endian = _field(found, "endian").lower()
        if endian not in ("little", "big"):
            raise refuse(f"NRRD endian = {endian!r}: little or big")
        dtype = dtype.newbyteorder("<" if endian == "little" else ">")
    encoding = _field(found, "encoding").lower()
    if encoding not in _ENCODINGS:
        raise refuse(f"NRRD encoding = {encoding!r}: raw, gzip or bzip2")
    for name in ("line skip", "lineskip", "byte skip", "byteskip"):
        if found.get(name, "0") != "0":
            raise refuse(f"NRRD {name} = {found[name]!r}: nothing may stand between header and voxels")
    sizes = [whole_number(n, "NRRD sizes") for n in _field(found, "sizes").split()]
    if len(sizes) != whole_number(_field(found, "dimension"), "NRRD dimension"):
        raise refuse(f"NRRD dimension = {found['dimension']} and sizes = {found['sizes']!r} differ")
    spacing, axes = None, OWN_AXES
    if "space directions" in found:
        vectors = _vectors(found["space directions"])
        spacing = checked_spacing([float(np.linalg.norm(v)) for v in vectors])
        frame = _FRAMES.get(found.get("space", "").lower())
        axes = axes_or_own(vectors, frame) if frame else OWN_AXES
    elif "spacings" in found:
        edges = found["spacings"].split()
        if len(edges) < 3:
            raise refuse(f"NRRD spacings = {found['spacings']!r}: three are needed")
        if "nan" not in found["spacings"].lower():
            spacing = checked_spacing([number(e, "NRRD spacings") for e in edges[:3]])
    return Header("nrrd", checked_shape(sizes), spacing, axes, dtype, _ENCODINGS[encoding], offset)


def _field(found: dict[str, str], name: str) -> str:
    if name not in found:
        raise refuse(f"the NRRD header has no {name!r}")
    return found[name]


def _vectors(text: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Three vectors such as "(1,0,0) (0,1,0) (0,0,1)", one a row."""
    rows = re.findall(r"\(([^)]*)\)", text)
    if len(rows) != 3 or any(len(row.split(",")) != 3 for row in rows):
        raise refuse(f"NRRD space directions = {text[:80]!r}: three vectors of three numbers")
    return np.array([[number(n, "NRRD space directions") for n in row.split(",")] for row in rows])
