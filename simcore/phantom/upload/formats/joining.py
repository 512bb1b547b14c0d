"""Header and voxels in two files become one file: only that has one digest, and knows by itself what it is."""

from __future__ import annotations

import contextlib
import re
import shutil
from dataclasses import replace
from pathlib import Path, PureWindowsPath
from typing import IO

from simcore.core.errors import SpecError
from simcore.phantom.upload.formats import metaimage, nrrd
from simcore.phantom.upload.formats.decoding import PIECE, begins_with_gzip, seek_voxels
from simcore.phantom.upload.formats.header import HEAD_BYTES, MAX_FIELD, MAX_HEADER_BYTES, Header, refuse

_LIST = re.compile(r"LIST(\s+\d+[dD]?)?")
_PATTERN = re.compile(r".*%\d*d.*\s-?\d+\s+-?\d+\s+-?\d+(\s+\d+)?")


def two_files(path: Path) -> tuple[Path, Header] | None:
    """Where the voxels of a header file (.mhd, .nhdr) lie, and what they are; None for any other file.

    raises: SpecError where the header or the file it names is of no use.
    """
    suffix = path.suffix.lower()
    if suffix in (".hdr", ".img"):
        raise refuse(f"{path.name} is one of two files (.hdr and .img): save them as one .nii or .nrrd file")
    if suffix not in (".mhd", ".nhdr"):
        return None
    head = _head(path)
    if suffix == ".mhd":
        entries, offset = metaimage.tags(head)
        name = entries[metaimage.LAST_TAG]
        if name.upper() == "LOCAL":
            return None
        header = metaimage.header_of(entries, 0)
    else:
        entries, offset = nrrd.fields(head)
        name = next((entries[n] for n in nrrd.DATA_FILE if n in entries), "")
        if not name:
            if offset < path.stat().st_size:
                return None
            raise refuse("the .nhdr header names no data file")
        header = nrrd.header_of(entries, 0)
    voxels = _beside(path, name)
    return voxels, _of_voxels(header, voxels, path, name)


def _head(path: Path) -> bytes:
    with open(path, "rb") as file:
        head = file.read(HEAD_BYTES)
        return head + file.read(MAX_HEADER_BYTES - HEAD_BYTES) if len(head) == HEAD_BYTES else head


def _beside(path: Path, name: str) -> Path:
    """The file of the voxels: as the header calls it below its folder, else beside it, whatever folder it names, in
    other case, or packed. raises: SpecError where there is none, or a list of them is named"""
    if len(name) > MAX_FIELD:
        raise refuse(f"{path.name} names a file of {len(name)} characters as that of its voxels")
    base = PureWindowsPath(name).name  # knows both separators
    if ".." not in Path(name).parts and not Path(name).is_absolute():
        with contextlib.suppress(OSError):  # a name that is too long
            if (path.parent / name).is_file():
                return path.parent / name
    known = {entry.name: entry for entry in path.parent.iterdir() if entry.is_file()}
    for candidate in (base, f"{base}.gz", base.removesuffix(".gz")):
        if candidate in known:
            return known[candidate]
        other_case = [known[n] for n in sorted(known) if n.lower() == candidate.lower()]
        if len(other_case) == 1:
            return other_case[0]
    raise _no_voxels(path, name, base)


def _no_voxels(path: Path, name: str, base: str) -> SpecError:
    named = f"{path.name} names {name[:80]!r} as the file of its voxels"
    if _LIST.fullmatch(name) or _PATTERN.fullmatch(name):
        return refuse(
            f"{named}, a list of slices: one file is needed. Join them, in Python with SimpleITK.WriteImage("
            f"SimpleITK.ReadImage({path.name!r}), 'labels.nrrd', True), or in 3D Slicer by saving as .nrrd, and add it"
        )
    return refuse(f"{named}, which is not beside it: put {base[:80]!r} into the folder of {path.name}")


def _of_voxels(header: Header, voxels: Path, path: Path, name: str) -> Header:
    """The header of the file of the voxels alone: packed or not as that file is."""
    remarks = header.remarks
    if voxels != path.parent / name:
        remarks = (*remarks, f"its voxels are read from {voxels.name!r}, where its header says {name[:80]!r}")
    encoding = header.encoding
    with open(voxels, "rb") as file:
        packed = begins_with_gzip(file)
    as_announced = header.encoding == "raw" and voxels.stat().st_size == header.voxel_bytes + max(header.skip, 0)
    if packed and not as_announced and header.offset == header.lines == 0:
        encoding = "gzip"
    if not packed and header.encoding == "gzip" and not header.lines:
        encoding = "raw"
    if encoding != "raw" and header.skip < 0:
        raise refuse(f"its header skips to the end of {voxels.name!r}, which is packed: unpack it")
    return replace(header, format="raw", encoding=encoding, remarks=remarks)


def join(header: Header, voxels: IO[bytes], target: IO[bytes]) -> None:
    """Writes one file with the voxels as they are, packed or not: NRRD, or MetaImage for zlib, which NRRD lacks.

    raises: SpecError where ``voxels`` ends before they begin.
    """
    seek_voxels(voxels, header)
    target.write(_metaimage(header) if header.encoding == "zlib" else _nrrd(header))
    shutil.copyfileobj(voxels, target, PIECE)


def _nrrd(header: Header) -> bytes:
    lines = [
        "NRRD0004",
        f"type: {nrrd.TYPES[header.dtype.str[1:]][0]}",
        "dimension: 3",
        f"sizes: {_fastest_first(header.shape)}",
        f"encoding: {header.encoding}",
    ]
    if header.dtype.itemsize > 1:
        lines.append(f"endian: {'big' if _big_endian(header) else 'little'}")
    if header.spacing_mm is not None:
        lines.append(f"spacings: {_fastest_first(header.spacing_mm)}")
    if header.encoding != "raw" and header.skip:
        lines.append(f"byte skip: {header.skip}")
    return ("\n".join(lines) + "\n\n").encode()


def _metaimage(header: Header) -> bytes:
    lines = ["ObjectType = Image", "NDims = 3", "BinaryData = True", "CompressedData = True"]
    lines.append(f"BinaryDataByteOrderMSB = {_big_endian(header)}")
    lines.append(f"DimSize = {_fastest_first(header.shape)}")
    if header.spacing_mm is not None:
        lines.append(f"ElementSpacing = {_fastest_first(header.spacing_mm)}")
    lines += [f"ElementType = {metaimage.TYPES[header.dtype.str[1:]][0]}", "ElementDataFile = LOCAL"]
    return ("\n".join(lines) + "\n").encode()


def _fastest_first(values: tuple[int, int, int] | tuple[float, float, float]) -> str:
    return " ".join(str(v) for v in reversed(values))


def _big_endian(header: Header) -> bool:
    return header.dtype.newbyteorder("=").str != header.dtype.str if header.dtype.itemsize > 1 else False
