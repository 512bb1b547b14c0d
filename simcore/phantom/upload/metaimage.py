"""MetaImage (.mha; .mhd by way of ``joining``): the tags of ITK's MetaIO."""

from __future__ import annotations

import numpy as np

from simcore.phantom.upload.header import (
    Header,
    axes_or_own,
    checked_shape,
    checked_spacing,
    number,
    refuse,
    whole_number,
)
from simcore.phantom.upload.spec import OWN_AXES

_DTYPES = {
    "MET_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
}
LAST_TAG = "elementdatafile"


def looks_like(head: bytes) -> bool:
    """Whether the first line is a tag that begins a MetaImage."""
    name = head.partition(b"=")[0].strip().lower()
    return name in (b"objecttype", b"ndims", b"comment", b"objectsubtype", b"dimsize")


def tags(head: bytes) -> tuple[dict[str, str], int]:
    """The tags of a header by their names in small letters, and where the voxels begin.

    raises: SpecError where the last one, ElementDataFile, is missing.
    """
    found: dict[str, str] = {}
    offset = 0
    while LAST_TAG not in found:
        end = head.find(b"\n", offset)
        line = head[offset : end if end >= 0 else len(head)].decode("latin-1").strip()
        name, equals, value = line.partition("=")
        if line and not equals:
            raise refuse(f"MetaImage header line {line[:60]!r}")
        if line:
            found[name.strip().lower()] = value.strip()
        if end < 0:
            break
        offset = end + 1
    if LAST_TAG not in found:
        raise refuse("the MetaImage header has no ElementDataFile")
    return found, offset


def parse(head: bytes) -> Header:
    """The header in the first bytes of a file. raises: SpecError"""
    found, offset = tags(head)
    if found[LAST_TAG].upper() != "LOCAL":
        raise refuse(
            f"its voxels are in another file, {found[LAST_TAG][:80]!r}: add the .mhd file where both lie, or save it "
            "as .mha"
        )
    return header_of(found, offset)


def header_of(found: dict[str, str], offset: int) -> Header:
    """The header that tags describe. raises: SpecError"""
    kind = _tag(found, "ElementType").upper()
    if kind not in _DTYPES:
        raise refuse(f"MetaImage ElementType = {kind!r}: labels are whole numbers ({', '.join(_DTYPES)})")
    if found.get("elementnumberofchannels", "1") != "1":
        raise refuse(f"MetaImage ElementNumberOfChannels = {found['elementnumberofchannels']}: 1")
    if not _true(found, "binarydata", default=True):
        raise refuse("MetaImage BinaryData = False: save it in binary form")
    if found.get("headersize", "0") not in ("0", "-1"):
        raise refuse(f"MetaImage HeaderSize = {found['headersize']}: 0")
    big = _true(found, "binarydatabyteordermsb") or _true(found, "elementbyteordermsb")
    dtype = np.dtype(_DTYPES[kind]).newbyteorder(">" if big else "<")
    sizes = [whole_number(n, "MetaImage DimSize") for n in _tag(found, "DimSize").split()]
    if len(sizes) != whole_number(_tag(found, "NDims"), "MetaImage NDims"):
        raise refuse(f"MetaImage NDims = {found['ndims']} and DimSize = {found['dimsize']!r} differ")
    spacing = None
    edges = found.get("elementspacing", found.get("elementsize"))
    if edges is not None:
        if len(edges.split()) < 3:
            raise refuse(f"MetaImage ElementSpacing = {edges!r}: three are needed")
        spacing = checked_spacing([number(e, "MetaImage ElementSpacing") for e in edges.split()[:3]])
    axes = OWN_AXES
    matrix = found.get("transformmatrix", found.get("orientation", found.get("rotation")))
    if matrix is not None and len(matrix.split()) == 9:
        directions = np.array([number(e, "MetaImage TransformMatrix") for e in matrix.split()]).reshape(3, 3)
        axes = axes_or_own(directions, "LPS")
    encoding = "zlib" if _true(found, "compresseddata") else "raw"
    return Header("metaimage", checked_shape(sizes), spacing, axes, dtype, encoding, offset)  # type: ignore[arg-type]


def _tag(found: dict[str, str], name: str) -> str:
    if name.lower() not in found:
        raise refuse(f"the MetaImage header has no {name}")
    return found[name.lower()]


def _true(found: dict[str, str], name: str, default: bool = False) -> bool:
    return found[name].lower() in ("true", "1", "t") if name in found else default
