"""NRRD with its voxels in the same file (teem.sourceforge.net/nrrd/format.html, versions 1 to 5)."""

from __future__ import annotations

import re
from functools import partial
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SpecError
from simcore.phantom.upload.formats.header import (
    Edges,
    Encoding,
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
from simcore.phantom.upload.formats.orientation import axes_or_own, axes_without_patient
from simcore.phantom.upload.formats.units import mm_per
from simcore.phantom.upload.spec import OWN_AXES, Axes

MAGIC = b"NRRD000"
DATA_FILE = ("data file", "datafile")
MAX_SKIPPED_LINES = 10_000
MAX_SKIPPED_BYTES = 2**24
"""Where they have to be unpacked."""

TYPES = {
    "i1": ("int8", "signed char", "int8_t"),
    "u1": ("uint8", "uchar", "unsigned char", "uint8_t"),
    "i2": ("int16", "short", "short int", "signed short", "signed short int", "int16_t"),
    "u2": ("uint16", "ushort", "unsigned short", "unsigned short int", "uint16_t"),
    "i4": ("int32", "int", "signed int", "int32_t"),
    "u4": ("uint32", "uint", "unsigned int", "uint32_t"),
    "i8": ("int64", "longlong", "long long", "long long int", "signed long long", "signed long long int", "int64_t"),
    "u8": ("uint64", "ulonglong", "unsigned long long", "unsigned long long int", "uint64_t"),
    "f4": ("float",),
    "f8": ("double",),
}
"""Names of every type, the one that is written first."""
_DTYPES = {name: dtype for dtype, names in TYPES.items() for name in names}
_ENCODINGS: dict[str, Encoding] = {"raw": "raw", "gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2"}
_READ = (
    *("type", "dimension", "sizes", "encoding", "endian", "space", "space directions", "space units", "spacings"),
    *("units", "line skip", "lineskip", "byte skip", "byteskip"),
)
_FRAMES = {
    "left-posterior-superior": "LPS",
    "lps": "LPS",
    "right-anterior-superior": "RAS",
    "ras": "RAS",
    "left-anterior-superior": "LAS",
    "las": "LAS",
}
_END = re.compile(rb"\r?\n\r?\n")
_DETACHED = re.compile(rb"(?im)^data ?file\s*:")


def is_whole(head: bytes) -> bool:
    """Whether the first bytes of a file hold all of its header."""
    return _END.search(head) is not None


def fields(head: bytes) -> tuple[dict[str, str], int]:
    """The fields of a header by their names in small letters, and where the voxels begin.

    raises: SpecError where the header does not end; one with its voxels in another file may.
    """
    end = _END.search(head)
    if end is None and not _DETACHED.search(head):
        raise refuse("the NRRD header has no end (an empty line)")
    text = head[: end.start()] if end else head
    entries: dict[str, str] = {}
    for line in _decoded(text).splitlines()[1:]:
        if line.startswith("#") or ":=" in line:
            continue
        name, colon, value = line.partition(":")
        if not colon:
            raise refuse(f"NRRD header line {line[:60]!r}")
        entries[name.strip().lower()] = value.strip()
        if name.strip().lower() in DATA_FILE and value.split()[:1] == ["LIST"]:
            break  # the rest are names of files
    return entries, end.end() if end else len(head)


def parse(head: bytes) -> Header:
    """The header in the first bytes of a file. raises: SpecError"""
    entries, offset = fields(head)
    if any(name in entries for name in DATA_FILE):
        raise refuse(
            "its voxels are in another file: add the .nhdr file with 'tomosim phantom add' where both lie, or put them "
            "into one .nrrd file"
        )
    return header_of(entries, offset)


def header_of(entries: dict[str, str], offset: int) -> Header:
    """The header that fields describe. raises: SpecError"""
    check_fields(entries, _READ)
    encoding = _field(entries, "encoding").lower()
    if encoding not in _ENCODINGS:
        raise refuse(f"NRRD encoding = {encoding!r}: save it as raw, gzip or bzip2")
    sizes = [whole_number(n, "NRRD sizes") for n in _field(entries, "sizes").split()]
    if len(sizes) != whole_number(_field(entries, "dimension"), "NRRD dimension"):
        raise refuse(f"NRRD dimension = {entries['dimension']} and sizes = {entries['sizes']!r} differ")
    vectors = _vectors(entries["space directions"], len(sizes)) if "space directions" in entries else None
    lists = [k for k, vector in enumerate(vectors) if vector is None] if vectors else []
    kept = volume_axes(sizes, lists)
    problems: dict[str, SpecError] = {}
    spacing = attempt(problems, "spacing_mm", partial(_spacing, entries, vectors, kept))
    axes = attempt(problems, "axes", partial(_axes, entries, vectors, kept))
    return Header(
        "nrrd",
        checked_shape([sizes[k] for k in kept], spacing),
        spacing,
        axes[0] if axes else None,
        _dtype(entries),
        _ENCODINGS[encoding],
        offset,
        lines=_skip(entries, "line skip", 0, MAX_SKIPPED_LINES),
        skip=_skip(entries, "byte skip", *((-1, 2**62) if encoding == "raw" else (0, MAX_SKIPPED_BYTES))),
        problems=problems,
        remarks=axes[1] if axes else (),
    )


def _dtype(entries: dict[str, str]) -> np.dtype[np.generic]:
    kind = _field(entries, "type").lower()
    if kind not in _DTYPES:
        raise refuse(f"NRRD type = {kind!r}: labels are numbers ({', '.join(names[0] for names in TYPES.values())})")
    dtype = np.dtype(_DTYPES[kind])
    if dtype.itemsize > 1:
        endian = _field(entries, "endian").lower()
        if endian not in ("little", "big"):
            raise refuse(f"NRRD endian = {endian!r}: little or big")
        dtype = dtype.newbyteorder("<" if endian == "little" else ">")
    return dtype


def _skip(entries: dict[str, str], name: str, least: int, most: int) -> int:
    value = whole_number(entries.get(name, entries.get(name.replace(" ", ""), "0")), f"NRRD {name}")
    if not least <= value <= most:
        only = "" if least < 0 or name == "line skip" else " (-1, the end of the file, only where encoding is raw)"
        raise refuse(f"NRRD {name} = {value}: from {least} to {most}{only}")
    return value


def _spacing(
    entries: dict[str, str], vectors: list[NDArray[np.float64] | None] | None, kept: list[int]
) -> Edges | None:
    """Voxel edges, mm; None where the header has none. raises: SpecError where they are of no use"""
    edges = _edges(entries, kept)
    if vectors is not None:
        length = mm_per(_one_unit(entries, ("space units", "units"), kept), "NRRD space units")
        norms = [float(np.linalg.norm(vectors[k])) * length for k in kept if vectors[k] is not None]  # type: ignore[arg-type]
        if len(norms) == 3:
            spacing = checked_spacing(norms, "NRRD space directions")
            if edges is not None and not np.allclose(edges[::-1], spacing, rtol=0.01):
                raise refuse(
                    f"NRRD space directions say voxels of {norms} mm, spacings {list(edges)}: give spacing_mm (mm, "
                    "slowest axis first)"
                )
            return spacing
    return None if edges is None else checked_spacing(edges, "NRRD spacings")


def _edges(entries: dict[str, str], kept: list[int]) -> list[float] | None:
    """Those of the field spacings, fastest first, mm; None without, or where one is NaN."""
    if "spacings" not in entries:
        return None
    edges = entries["spacings"].split()
    if len(edges) <= max(kept):
        raise refuse(f"NRRD spacings = {entries['spacings']!r}: three are needed")
    if any(edges[k].lower() in ("nan", "none", "???") for k in kept):
        return None
    length = mm_per(_one_unit(entries, ("units", "space units"), kept), "NRRD units")
    return [number(edges[k], "NRRD spacings") * length for k in kept]


def _one_unit(entries: dict[str, str], names: tuple[str, str], kept: list[int]) -> str:
    """The unit of all axes; "" where none is given. raises: SpecError where they differ"""
    text = next((entries[name] for name in names if name in entries), "")
    units = re.findall(r'"([^"]*)"', text) or text.split()
    if len(units) > 3 and len(units) > max(kept):
        units = [units[k] for k in kept]
    distinct = {unit.strip() for unit in units} - {""}
    if len(distinct) > 1:
        raise refuse(f"NRRD units = {text[:80]!r}: one for all axes is needed; give spacing_mm")
    return next(iter(distinct), "")


def _axes(
    entries: dict[str, str], vectors: list[NDArray[np.float64] | None] | None, kept: list[int]
) -> tuple[Axes, tuple[str, ...]]:
    """Where the axes lead, and what to tell of it. raises: SpecError where that is not to be had"""
    rows = [vectors[k] for k in kept if vectors[k] is not None] if vectors else []
    if len(rows) < 3:
        return OWN_AXES, ()
    space = entries.get("space", "")
    frame = _FRAMES.get(space.lower())
    directions = np.array(rows)
    return axes_or_own(directions, frame) if frame else axes_without_patient(directions, space or "space dimension")


def _field(entries: dict[str, str], name: str) -> str:
    if name not in entries:
        raise refuse(f"the NRRD header has no {name!r}")
    return entries[name]


def _vectors(text: str, axes: int) -> list[NDArray[np.float64] | None]:
    """Vectors such as "none (1,0,0) (0,1,0) (0,0,1)", one an axis."""
    words = re.findall(r"\(([^)]*)\)|(\S+)", text)
    rows = [None if word.lower() == "none" else row.split(",") for row, word in words]
    ok = all(word.lower() in ("", "none") for _, word in words) and all(r is None or len(r) == 3 for r in rows)
    if not ok or len(rows) != axes:
        raise refuse(f"NRRD space directions = {text[:80]!r}: for each of {axes} axes three numbers, or none")
    return [None if r is None else np.array(list(map(number, r, repeat("NRRD space directions")))) for r in rows]


def _decoded(text: bytes) -> str:
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")
