"""Frames and whole objects as they are sent: by offset in the file where they lie uncompressed, else one by one."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from pydicom.encaps import encapsulate, get_frame
from pydicom.filewriter import dcmwrite
from pydicom.pixels import get_decoder
from pydicom.uid import ExplicitVRLittleEndian

from api.http.errors import ApiError
from simcore.store.store import Store
from worker.dicom_index.files import open_stored, read_header
from worker.dicom_index.index import Instance, Pixels


class Frames:
    """The frames of one instance.

    raises: ApiError 404 where it has no pixel data
    """

    def __init__(self, store: Store, instance: Instance) -> None:
        if instance.pixels is None:
            raise ApiError(404, "no-pixel-data", f"{instance.uid} has no pixel data")
        self.instance = instance
        self.pixels: Pixels = instance.pixels
        self.store = store
        self.ref = instance.file

    @property
    def compressed(self) -> bool:
        return self.pixels.length is None

    def stored(self, number: int) -> bytes:
        """A compressed frame as it lies in the file; number: 1 ..."""
        with open_stored(self.store, self.ref) as file:
            file.seek(self.pixels.offset)
            return bytes(get_frame(file, number - 1, number_of_frames=self.pixels.frames))

    def plain(self, number: int) -> bytes:
        """A frame uncompressed, little endian; number: 1 ..."""
        if self.compressed:
            return np.ascontiguousarray(self._decoded(number)).tobytes()
        first, bits = divmod((number - 1) * self.pixels.frame_bits, 8)
        length = (bits + self.pixels.frame_bits + 7) // 8
        content = b"".join(self.store.stream(self.ref, self.pixels.offset + first, length))
        return content if bits == 0 and self.pixels.frame_bits % 8 == 0 else _aligned(content, bits, self.pixels)

    def chunks(self, first: int, length: int) -> Iterator[bytes]:
        """Bytes of the uncompressed pixel data of all frames, frame by frame where it lies compressed."""
        if not self.compressed:
            yield from self.store.stream(self.ref, self.pixels.offset + first, length)
            return
        size = self.pixels.frame_bytes
        while length > 0:
            number, start = divmod(first, size)
            if number >= self.pixels.frames:
                yield bytes(length)  # the padding to an even length
                return
            piece = self.plain(number + 1)[start : start + length]
            yield piece
            first += len(piece)
            length -= len(piece)

    @property
    def plain_length(self) -> int:
        """Bytes of the uncompressed pixel data of all frames, even."""
        if self.pixels.length is not None:
            return self.pixels.length
        length = self.pixels.frame_bytes * self.pixels.frames
        return length + length % 2

    def array(self, number: int) -> NDArray[np.generic]:
        """A frame as stored values (rows, columns) or (rows, columns, samples); number: 1 ..."""
        p = self.pixels
        content = self.plain(number)
        if p.bits == 1:
            flat = np.unpackbits(np.frombuffer(content, np.uint8), bitorder="little")[: p.frame_bits]
        else:
            kinds = {"7FE00008": "<f4", "7FE00009": "<f8"}
            flat = np.frombuffer(content, kinds.get(p.tag, f"<u{p.bits // 8}"))
        return flat.reshape((p.rows, p.columns) if p.samples == 1 else (p.rows, p.columns, p.samples))

    def _decoded(self, number: int) -> NDArray[np.generic]:
        p = self.pixels
        decoder = get_decoder(self.instance.transfer_syntax)
        decoded: NDArray[np.generic] = decoder.as_array(
            encapsulate([self.stored(number)]),
            index=0,
            raw=True,
            rows=p.rows,
            columns=p.columns,
            samples_per_pixel=p.samples,
            number_of_frames=1,
            bits_allocated=p.bits,
            bits_stored=p.bits,
            pixel_representation=0,
            photometric_interpretation="MONOCHROME2" if p.samples == 1 else "RGB",
            planar_configuration=0,
            pixel_keyword="PixelData",
        )[0]
        return decoded


def uncompressed_head(store: Store, instance: Instance) -> bytes:
    """A file up to its pixel data, rewritten for uncompressed pixels, with the header of that element."""
    frames = Frames(store, instance)
    with open_stored(store, instance.file) as file:
        dataset = read_header(file).dataset
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    buffer = io.BytesIO()
    dcmwrite(buffer, dataset, enforce_file_format=True)
    vr = b"OW" if frames.pixels.bits > 8 else b"OB"
    return buffer.getvalue() + struct.pack("<HH2s2xI", 0x7FE0, 0x0010, vr, frames.plain_length)


def _aligned(content: bytes, bits: int, pixels: Pixels) -> bytes:
    """Bits of a frame that begins within a byte, moved to the beginning of one."""
    unpacked = np.unpackbits(np.frombuffer(content, np.uint8), bitorder="little")
    return np.packbits(unpacked[bits : bits + pixels.frame_bits], bitorder="little").tobytes()
