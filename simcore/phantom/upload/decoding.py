"""Voxels of a file, unpacked piece by piece and never more than the header announces."""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Iterator
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from simcore.phantom.upload import metaimage, nifti, nrrd
from simcore.phantom.upload.header import MAX_HEADER_BYTES, Encoding, Header, refuse

PIECE = 1 << 20
"""Bytes that are read or unpacked at a time."""
GZIP = b"\x1f\x8b"
_WINDOW = {"gzip": 31, "zlib": 15}


def read_header(file: IO[bytes]) -> Header:
    """The header of a file of any format, told by its first bytes. The file must be seekable.

    raises: SpecError
    """
    file.seek(0)
    head = file.read(MAX_HEADER_BYTES)
    whole_gzip = head[:2] == GZIP
    if whole_gzip:
        file.seek(0)
        head = _first_bytes(file, MAX_HEADER_BYTES)
    if nifti.looks_like(head):
        return nifti.parse(head, whole_gzip)
    if whole_gzip:
        raise refuse("a gzip file that is no NIfTI: raw voxels need a header beside them (shape and voxel size)")
    if head.startswith(nrrd.MAGIC):
        return nrrd.parse(head)
    if metaimage.looks_like(head):
        return metaimage.parse(head)
    raise refuse("it is no NRRD, MetaImage or NIfTI file; raw voxels need a header beside them (shape and voxel size)")


def begins_with_gzip(file: IO[bytes]) -> bool:
    """Whether a file is gzip-compressed, by its first bytes."""
    file.seek(0)
    return file.read(2) == GZIP


def planes(file: IO[bytes], header: Header) -> Iterator[tuple[int, NDArray[Any]]]:
    """(first plane, voxels (n, shape[1], shape[2])) of a file, some planes along its slowest axis at a time.

    raises: SpecError where there are fewer or more voxels than the header says, or they cannot be unpacked.
    """
    _, rows, columns = header.shape
    plane_bytes = rows * columns * header.dtype.itemsize
    group = max(1, PIECE // plane_bytes) * plane_bytes
    pending = bytearray()
    done = 0
    for piece in _exactly(file, header):
        pending += piece
        whole = len(pending) // group * group
        if whole:
            yield done, _planes(pending, whole, header)
            done += whole // plane_bytes
            del pending[:whole]
    if pending:
        yield done, _planes(pending, len(pending), header)


def _planes(data: bytearray, length: int, header: Header) -> NDArray[Any]:
    return np.frombuffer(bytes(data[:length]), header.dtype).reshape(-1, *header.shape[1:])


def _exactly(file: IO[bytes], header: Header) -> Iterator[bytes]:
    """The voxels' bytes. raises: SpecError as ``planes``"""
    expected = header.voxel_bytes
    done = 0
    for piece in _unpacked(file, header):
        done += len(piece)
        if done > expected:
            raise refuse(f"it holds more than the {expected} bytes of {' x '.join(map(str, header.shape))} voxels")
        yield piece
    if done < expected:
        raise refuse(
            f"it ends after {done} of the {expected} bytes of {' x '.join(map(str, header.shape))} voxels",
            "upload-cut-short",
        )


def _unpacked(file: IO[bytes], header: Header) -> Iterator[bytes]:
    if header.whole_gzip:
        file.seek(0)
        skip = header.offset
        for piece in _pieces(file, "gzip"):
            yield piece[skip:]
            skip = max(0, skip - len(piece))
        return
    file.seek(header.offset)
    yield from _pieces(file, header.encoding)


def _pieces(file: IO[bytes], encoding: Encoding) -> Iterator[bytes]:
    """What the rest of the file unpacks to, in pieces of at most PIECE bytes."""
    if encoding == "raw":
        while piece := file.read(PIECE):
            yield piece
        return
    try:
        yield from _bzip2(file) if encoding == "bzip2" else _deflate(file, _WINDOW[encoding])
    except (zlib.error, OSError, ValueError, EOFError) as error:
        raise refuse(f"it cannot be unpacked ({encoding}): {error}") from error


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
                    raise refuse("its packed voxels are cut short", "upload-cut-short")
        data = data or file.read(PIECE)
        if window != _WINDOW["gzip"] or data[:2] != GZIP:
            return  # padding after the voxels


def _bzip2(file: IO[bytes]) -> Iterator[bytes]:
    unpacker = bz2.BZ2Decompressor()
    while not unpacker.eof:
        data = file.read(PIECE) if unpacker.needs_input else b""
        if unpacker.needs_input and not data:
            raise refuse("its packed voxels are cut short", "upload-cut-short")
        if piece := unpacker.decompress(data, PIECE):
            yield piece


def _first_bytes(file: IO[bytes], count: int) -> bytes:
    """At most ``count`` bytes of what a gzip file unpacks to."""
    try:
        return zlib.decompressobj(_WINDOW["gzip"]).decompress(file.read(count), count)
    except zlib.error as error:
        raise refuse(f"it cannot be unpacked (gzip): {error}") from error
