"""Voxels of a file, unpacked piece by piece and never more than the header announces."""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Iterator
from dataclasses import replace
from io import SEEK_CUR, SEEK_END
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from simcore.phantom.upload.formats import foreign, metaimage, nifti, nrrd
from simcore.phantom.upload.formats.header import HEAD_BYTES, MAX_HEADER_BYTES, Encoding, Header, refuse

PIECE = 1 << 20
"""Bytes that are read or unpacked at a time."""
_AGAIN = "fetch it again, or save it again as raw or gzip"
MAX_LINE_BYTES = 1 << 16
GZIP = b"\x1f\x8b"
BZIP2 = b"BZh"
_WINDOW = {"gzip": 31, "zlib": 47}
"""For zlib whichever of the two it is: MetaIO takes either."""


def read_header(file: IO[bytes]) -> Header:
    """The header of a file of any format, told by its first bytes. The file must be seekable.

    raises: SpecError
    """
    head = head_of(file)
    whole_gzip = begins_with_gzip(file)
    if nifti.looks_like(head):
        return nifti.parse(head, whole_gzip)
    if not (head.startswith(nrrd.MAGIC) or metaimage.looks_like(head)):
        raise refuse(foreign.explain(head, file, whole_gzip))
    header = nrrd.parse(head) if head.startswith(nrrd.MAGIC) else metaimage.parse(head)
    if not whole_gzip:
        return header
    if header.encoding != "raw" or header.lines or header.skip < 0:
        raise refuse("it is gzip-compressed as a whole, and its voxels are packed or come after a skip: unpack it once")
    return replace(header, encoding="gzip", whole_gzip=True)


def head_of(file: IO[bytes]) -> bytes:
    """The first bytes of a file, unpacked where it is gzip-compressed; with all of a header of NRRD or MetaImage."""
    head = first_bytes(file, HEAD_BYTES)
    is_whole = nrrd.is_whole if head.startswith(nrrd.MAGIC) else metaimage.is_whole
    if (head.startswith(nrrd.MAGIC) or metaimage.looks_like(head)) and not is_whole(head):
        return first_bytes(file, MAX_HEADER_BYTES)
    return head


def first_bytes(file: IO[bytes], count: int) -> bytes:
    """At most ``count`` first bytes of a file, or where it is gzip-compressed of what it unpacks to."""
    file.seek(0)
    head = file.read(count)
    if head[:2] != GZIP:
        return head
    try:
        return zlib.decompressobj(_WINDOW["gzip"]).decompress(head, count)
    except zlib.error as error:
        raise refuse(f"it cannot be unpacked (gzip): {error}; {_AGAIN}") from error


def begins_with_gzip(file: IO[bytes]) -> bool:
    """Whether a file is gzip-compressed, by its first bytes."""
    file.seek(0)
    return file.read(2) == GZIP


def blocks(file: IO[bytes], header: Header) -> Iterator[tuple[int, int, NDArray[Any]]]:
    """(first plane, first row, values (n, rows, shape[2])) of a file: some planes along its slowest axis at a time, or
    where they are large some rows of one. Values are as they are stored (``values.labels_of``).

    raises: SpecError where there are fewer or more voxels than the header says, or they cannot be unpacked.
    """
    columns = header.shape[2]
    row_bytes = columns * header.dtype.itemsize
    pieces = _exactly(file, header)
    pending = bytearray()
    for plane, row, n, rows in _cut(header.shape, max(1, PIECE // row_bytes)):
        size = n * rows * row_bytes
        while len(pending) < size:
            pending += next(pieces)
        yield plane, row, np.frombuffer(bytes(memoryview(pending)[:size]), header.dtype).reshape(n, rows, columns)
        del pending[:size]
    for _ in pieces:  # says where there are too many
        pass


def _cut(shape: tuple[int, int, int], rows_held: int) -> Iterator[tuple[int, int, int, int]]:
    """(first plane, first row, planes, rows) of blocks of at most ``rows_held`` rows."""
    planes, rows, _ = shape
    if rows <= rows_held:
        group = rows_held // rows
        yield from ((first, 0, min(group, planes - first), rows) for first in range(0, planes, group))
        return
    for plane in range(planes):
        yield from ((plane, first, 1, min(rows_held, rows - first)) for first in range(0, rows, rows_held))


def _exactly(file: IO[bytes], header: Header) -> Iterator[bytes]:
    """The voxels' bytes, in pieces that are not empty. raises: SpecError as ``blocks``"""
    expected = header.voxel_bytes
    done = 0
    for piece in _unpacked(file, header):
        done += len(piece)
        if done > expected:
            raise refuse(
                f"it holds more than the {expected} bytes of {_voxels(header)}: correct their number, their type "
                f"({header.dtype.name}) or the bytes before them, or save it again"
            )
        if piece:
            yield piece
    if done < expected:
        raise refuse(
            f"it ends after {done} of the {expected} bytes of {_voxels(header)}: fetch or save it again, or correct "
            f"their number or type ({header.dtype.name})",
            "upload-cut-short",
        )


def _voxels(header: Header) -> str:
    return f"{' x '.join(map(str, header.shape))} voxels"


def _unpacked(file: IO[bytes], header: Header) -> Iterator[bytes]:
    if header.whole_gzip:
        file.seek(0)
        yield from _without(_pieces(file, "gzip"), header.offset + header.skip)
        return
    seek_voxels(file, header)
    packed = header.encoding != "raw"
    yield from _without(_pieces(file, header.encoding), header.skip if packed else 0)


def seek_voxels(file: IO[bytes], header: Header) -> None:
    """Goes to the first byte of the voxels, or where they are packed of what unpacks to them and the bytes to skip.

    raises: SpecError where the file ends before.
    """
    if header.skip < 0:
        end = file.seek(0, SEEK_END)
        if end < header.voxel_bytes:
            raise refuse(f"it has {end} bytes, its voxels need {header.voxel_bytes}", "upload-cut-short")
        file.seek(end - header.voxel_bytes)
        return
    file.seek(header.offset)
    for n in range(header.lines):
        if not file.readline(MAX_LINE_BYTES).endswith(b"\n"):
            raise refuse(f"NRRD line skip = {header.lines}: line {n + 1} has no end within {MAX_LINE_BYTES} bytes")
    if header.encoding == "raw":
        file.seek(header.skip, SEEK_CUR)


def _without(pieces: Iterator[bytes], skip: int) -> Iterator[bytes]:
    """Pieces without their first ``skip`` bytes."""
    for piece in pieces:
        yield piece[skip:]
        skip = max(0, skip - len(piece))


def _pieces(file: IO[bytes], encoding: Encoding) -> Iterator[bytes]:
    """What the rest of the file unpacks to, in pieces of at most PIECE bytes."""
    if encoding == "raw":
        while piece := file.read(PIECE):
            yield piece
        return
    try:
        yield from _bzip2(file) if encoding == "bzip2" else _deflate(file, _WINDOW[encoding])
    except (zlib.error, OSError, ValueError, EOFError) as error:
        raise refuse(f"it cannot be unpacked ({encoding}): {error}; {_AGAIN}") from error


def _deflate(file: IO[bytes], window: int) -> Iterator[bytes]:
    """gzip (any number of members) or zlib."""
    data = file.read(PIECE)
    while data:
        unpacker = zlib.decompressobj(window)
        while not unpacker.eof:
            if piece := unpacker.decompress(data, PIECE):
                yield piece
            data = unpacker.unconsumed_tail or (unpacker.unused_data if unpacker.eof else file.read(PIECE))
            if not data and not unpacker.eof:
                yield unpacker.flush()
                if not unpacker.eof:
                    raise refuse(f"its packed voxels are cut short; {_AGAIN}", "upload-cut-short")
        if len(data) < len(GZIP):
            data += file.read(max(PIECE, len(GZIP)))
        if window != _WINDOW["gzip"] or data[:2] != GZIP:
            return  # padding after the voxels


def _bzip2(file: IO[bytes]) -> Iterator[bytes]:
    """bzip2 (any number of streams)."""
    data = file.read(PIECE)
    while data:
        unpacker = bz2.BZ2Decompressor()
        while not unpacker.eof:
            if piece := unpacker.decompress(data, PIECE):
                yield piece
            data = b"" if not unpacker.needs_input or unpacker.eof else file.read(PIECE)
            if unpacker.needs_input and not unpacker.eof and not data:
                raise refuse(f"its packed voxels are cut short; {_AGAIN}", "upload-cut-short")
        data = unpacker.unused_data
        if len(data) < len(BZIP2):
            data += file.read(max(PIECE, len(BZIP2)))
        if not data.startswith(BZIP2):
            return  # padding after the voxels
