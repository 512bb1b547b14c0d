"""MetaImage (.mha; .mhd by way of ``joining``): the tags of ITK's MetaIO."""

from __future__ import annotations

import re
from functools import partial

import numpy as np

from simcore.core.errors import SpecError
from simcore.phantom.upload.formats.header import (
    Edges,
    Header,
    attempt,
    check_fields,
    checked_shape,
    checked_spacing,
    number,
    refuse,
    whole_number,
)
from simcore.phantom.upload.formats.layers import volume_axes
from simcore.phantom.upload.formats.orientation import axes_or_own
from simcore.phantom.upload.formats.units import mm_per
from simcore.phantom.upload.spec import OWN_AXES, Axes

TYPES = {
    "i1": ("MET_CHAR",),
    "u1": ("MET_UCHAR",),
    "i2": ("MET_SHORT",),
    "u2": ("MET_USHORT",),
    "i4": ("MET_INT", "MET_LONG"),
    "u4": ("MET_UINT", "MET_ULONG"),
    "i8": ("MET_LONG_LONG",),
    "u8": ("MET_ULONG_LONG",),
    "f4": ("MET_FLOAT",),
    "f8": ("MET_DOUBLE",),
}
"""Names of every type, the one that is written first. MetaIO's long has four bytes."""
_DTYPES = {name: dtype for dtype, names in TYPES.items() for name in names}
LAST_TAG = "elementdatafile"
_READ = (
    *("ndims", "dimsize", "elementtype", "elementspacing", "elementsize", "transformmatrix", "orientation", "rotation"),
    *("headersize", "distanceunits", "elementnumberofchannels", LAST_TAG),
)
_LAST = re.compile(rb"(?im)^[ \t]*ElementDataFile[ \t]*=.*\n")
_FIRST = re.compile(
    rb"(?i)\s*(ObjectType|ObjectSubType|NDims|Comment|Name|ID|DimSize|BinaryData|BinaryDataByteOrderMSB|CompressedData"
    rb"|ElementType|ElementSpacing|TransformMatrix|Offset|AnatomicalOrientation|DistanceUnits)\s*="
)


def looks_like(head: bytes) -> bool:
    """Whether the first line is a tag that begins a MetaImage."""
    return _FIRST.match(head) is not None


def is_whole(head: bytes) -> bool:
    """Whether the first bytes of a file hold all of its header."""
    return _LAST.search(head) is not None


def tags(head: bytes) -> tuple[dict[str, str], int]:
    """The tags of a header by their names in small letters, and where the voxels begin.

    raises: SpecError where the last one, ElementDataFile, is missing.
    """
    entries: dict[str, str] = {}
    offset = 0
    while LAST_TAG not in entries:
        end = head.find(b"\n", offset)
        line = _decoded(head[offset : end if end >= 0 else len(head)]).strip()
        name, equals, value = line.partition("=")
        if line and not equals:
            raise refuse(f"MetaImage header line {line[:60]!r}")
        if line:
            entries[name.strip().lower()] = value.strip()
        if end < 0:
            break
        offset = end + 1
    if LAST_TAG not in entries:
        raise refuse("the MetaImage header has no ElementDataFile")
    return entries, offset


def parse(head: bytes) -> Header:
    """The header in the first bytes of a file. raises: SpecError"""
    entries, offset = tags(head)
    if entries[LAST_TAG].upper() != "LOCAL":
        raise refuse(
            f"its voxels are in another file, {entries[LAST_TAG][:80]!r}: add the .mhd file with 'tomosim phantom add' "
            "where both lie, or save it as .mha"
        )
    return header_of(entries, offset)


def header_of(entries: dict[str, str], offset: int) -> Header:
    """The header that tags describe. raises: SpecError"""
    check_fields(entries, _READ)
    if entries.get("elementnumberofchannels", "1") != "1":
        raise refuse(
            f"MetaImage ElementNumberOfChannels = {entries['elementnumberofchannels']}: 1; one label a voxel is "
            "needed, no colours or layers"
        )
    if not _true(entries, "binarydata", default=True):
        raise refuse("MetaImage BinaryData = False: save it in binary form")
    for name, nothing in (("ElementToIntensityFunctionSlope", 1.0), ("ElementToIntensityFunctionOffset", 0.0)):
        if number(entries.get(name.lower(), str(nothing)), f"MetaImage {name}") != nothing:
            raise refuse(
                f"MetaImage {name} = {entries[name.lower()]}: remove it where the stored values are the labels"
            )
    sizes = [whole_number(n, "MetaImage DimSize") for n in _tag(entries, "DimSize").split()]
    if len(sizes) != whole_number(_tag(entries, "NDims"), "MetaImage NDims"):
        raise refuse(f"MetaImage NDims = {entries['ndims']} and DimSize = {entries['dimsize']!r} differ")
    kept = volume_axes(sizes)
    problems: dict[str, SpecError] = {}
    spacing = attempt(problems, "spacing_mm", partial(_spacing, entries, kept))
    axes = attempt(problems, "axes", partial(_axes, entries, len(sizes), kept))
    compressed = _true(entries, "compresseddata")
    at, skip = _header_size(entries, offset, compressed)
    return Header(
        "metaimage",
        checked_shape([sizes[k] for k in kept], spacing),
        spacing,
        axes[0] if axes else None,
        _dtype(entries),
        "zlib" if compressed else "raw",
        at,
        skip=skip,
        problems=problems,
        remarks=axes[1] if axes else (),
    )


def _dtype(entries: dict[str, str]) -> np.dtype[np.generic]:
    kind = _tag(entries, "ElementType").upper()
    if kind not in _DTYPES:
        raise refuse(f"MetaImage ElementType = {kind!r}: labels are numbers ({', '.join(_DTYPES)})")
    big = _true(entries, "binarydatabyteordermsb") or _true(entries, "elementbyteordermsb")
    return np.dtype(_DTYPES[kind]).newbyteorder(">" if big else "<")


def _header_size(entries: dict[str, str], offset: int, compressed: bool) -> tuple[int, int]:
    """(offset, skip) of the voxels: HeaderSize counts from the beginning of their file; -1: they end it."""
    size = whole_number(entries.get("headersize", "0"), "MetaImage HeaderSize")
    local = entries[LAST_TAG].upper() == "LOCAL"
    if size < -1 or (size == -1 and compressed) or 0 < size < offset:
        least = f"0, or from {offset} on" if local else "0 or more"
        raise refuse(f"MetaImage HeaderSize = {size}: {least}; -1 (the end of the file) only where nothing is packed")
    if size == -1:
        return offset, -1
    return (size or offset), 0


def _spacing(entries: dict[str, str], kept: list[int]) -> Edges | None:
    """Voxel edges, mm; None where the header has none. raises: SpecError where they are of no use"""
    edges = entries.get("elementspacing", entries.get("elementsize"))
    if edges is None:
        return None
    if len(edges.split()) <= max(kept):
        raise refuse(f"MetaImage ElementSpacing = {edges!r}: three are needed; give spacing_mm")
    length = mm_per(entries.get("distanceunits", ""), "MetaImage DistanceUnits")
    values = [number(e, "MetaImage ElementSpacing") for e in edges.split()]
    return checked_spacing([values[k] * length for k in kept], "MetaImage ElementSpacing")


def _axes(entries: dict[str, str], dimensions: int, kept: list[int]) -> tuple[Axes, tuple[str, ...]]:
    """Where the axes lead, and what to tell of it. raises: SpecError where that is not to be had"""
    matrix = entries.get("transformmatrix", entries.get("orientation", entries.get("rotation")))
    if matrix is None:
        return OWN_AXES, ()
    values = [number(e, "MetaImage TransformMatrix") for e in matrix.split()]
    if len(values) != dimensions**2:
        raise refuse(f"MetaImage TransformMatrix = {matrix[:80]!r}: {dimensions**2} numbers, or give axes")
    directions = np.array(values).reshape(dimensions, dimensions)[np.ix_(kept, kept)]
    return axes_or_own(directions, "LPS")


def _tag(entries: dict[str, str], name: str) -> str:
    if name.lower() not in entries:
        raise refuse(f"the MetaImage header has no {name}")
    return entries[name.lower()]


def _true(entries: dict[str, str], name: str, default: bool = False) -> bool:
    return entries[name].lower() in ("true", "1", "t") if name in entries else default


def _decoded(text: bytes) -> str:
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")
