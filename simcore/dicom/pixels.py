"""Pixel data as it is written: frame by frame, plain or losslessly encoded, never a copy of the whole in memory."""

from __future__ import annotations

import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray
from pydicom.uid import ExplicitVRLittleEndian, JPEGLSLossless, RLELossless

from simcore.core.errors import ExportError
from simcore.dicom.limits import MAX_BYTES

_ITEM = b"\xfe\xff\x00\xe0"
_SEQUENCE_END = b"\xfe\xff\xdd\xe0" + b"\0" * 4
_ENCODERS = 2
"""Frames encoded at a time."""


class Frames(Protocol):
    """Frames of one image: an array (frames, rows, columns), or what makes each when it is asked for."""

    def __len__(self) -> int: ...

    def __getitem__(self, k: int, /) -> NDArray[Any]: ...


@dataclass(frozen=True)
class MadeFrames:
    """Frames that are computed one at a time. make: frame number (from 0) to array (rows, columns)."""

    count: int
    make: Callable[[int], NDArray[Any]]

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, k: int) -> NDArray[Any]:
        return self.make(k)


def _little_endian(frame: NDArray[Any]) -> NDArray[Any]:
    if frame.dtype.kind not in "uf" or frame.dtype.str.startswith(">"):
        raise ExportError(f"pixel data of type {frame.dtype}: unsigned integers and floats, little-endian, are allowed")
    return np.ascontiguousarray(frame)


def _jpeg_ls(frame: NDArray[Any], bits: int) -> bytes:
    # Here and not above: who writes no JPEG-LS need not have the library.
    import jpeg_ls

    rows, columns = frame.shape
    encoded = bytes(
        jpeg_ls.encode_pixel_data(
            _little_endian(frame).tobytes(), rows=rows, columns=columns, samples_per_pixel=1, bits_stored=bits
        )
    )
    return encoded + b"\0" * (len(encoded) % 2)


def _run_length(frame: NDArray[Any], bits: int) -> bytes:
    from simcore.dicom.run_length import run_length_frame

    return run_length_frame(_little_endian(frame))


TRANSFER_SYNTAXES = {"none": ExplicitVRLittleEndian, "jpeg-ls": JPEGLSLossless, "rle": RLELossless}
"""Transfer syntax of every ``ExportSpec.encoding``."""

_FRAME_ENCODERS: dict[str, Callable[[NDArray[Any], int], bytes]] = {"jpeg-ls": _jpeg_ls, "rle": _run_length}


def write_plain(file: BinaryIO, tag: tuple[int, int], vr: str, frames: Frames) -> None:
    """Append an element of uncompressed frames (explicit VR little endian).

    raises: ExportError where they are too large for one element.
    """
    length = len(frames) * frames[0].nbytes
    if length > MAX_BYTES:
        raise ExportError(
            f"{length} bytes of pixel data; an element holds at most {MAX_BYTES}: take fewer slices or views, or "
            "larger pixels"
        )
    file.write(struct.pack("<HH2sHL", *tag, vr.encode(), 0, length + length % 2))
    for k in range(len(frames)):
        file.write(memoryview(_little_endian(frames[k])).cast("B"))  # type: ignore[arg-type]
    file.write(b"\0" * (length % 2))


def write_encoded(file: BinaryIO, encoding: str, frames: Frames, bits: int) -> None:
    """Append Pixel Data of encoded frames, one fragment a frame, with a Basic Offset Table.

    encoding: "jpeg-ls" or "rle". bits: bits stored.
    raises: ExportError where the encoded frames exceed what the table can tell.
    """
    encode = _FRAME_ENCODERS[encoding]
    count = len(frames)
    file.write(struct.pack("<HH2sHL", 0x7FE0, 0x0010, b"OB", 0, 0xFFFFFFFF))
    file.write(_ITEM + struct.pack("<L", 4 * count))
    table = file.tell()
    file.write(b"\0" * (4 * count))
    offsets, position = [], 0
    with ThreadPoolExecutor(_ENCODERS) as pool:
        # As many in flight as there are encoders, so that little more than that is held.
        for first in range(0, count, _ENCODERS):
            group = [frames[k] for k in range(first, min(first + _ENCODERS, count))]
            for encoded in pool.map(encode, group, [bits] * len(group)):
                offsets.append(position)
                file.write(_ITEM + struct.pack("<L", len(encoded)))
                file.write(encoded)
                position += 8 + len(encoded)
    if position > MAX_BYTES:
        raise ExportError(f"{position} bytes of encoded frames; {MAX_BYTES} are allowed: take fewer slices or views")
    file.write(_SEQUENCE_END)
    end = file.tell()
    file.seek(table)
    file.write(struct.pack(f"<{count}L", *offsets))
    file.seek(end)
