"""What is read of a DICOM file without its pixels: the attributes, and where the frames lie."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from typing import Any, BinaryIO, cast

import pydicom
from pydicom.dataset import Dataset
from pydicom.uid import UID, DeflatedExplicitVRLittleEndian, ExplicitVRBigEndian, ImplicitVRLittleEndian

from simcore.store.hashing import FileRef
from simcore.store.store import Store
from worker.dicom_index.index import Pixels

_UNDEFINED = 0xFFFFFFFF
_UNREADABLE = (ImplicitVRLittleEndian, DeflatedExplicitVRLittleEndian, ExplicitVRBigEndian)


BUFFER_BYTES = 1 << 18


@dataclass(frozen=True)
class Header:
    """A file without its pixels."""

    dataset: Dataset
    transfer_syntax: str
    pixels: Pixels | None


def read_header(file: BinaryIO) -> Header:
    """Reads the attributes in front of the pixel data, and no pixel.

    file: a DICOM file, seekable, at its beginning.
    raises: ValueError where it is none, or its transfer syntax is not explicit VR, little endian.
    """
    try:
        dataset = pydicom.dcmread(file, stop_before_pixels=True)
        syntax = str(dataset.file_meta.TransferSyntaxUID)
    except (pydicom.errors.InvalidDicomError, AttributeError, EOFError, struct.error) as error:
        raise ValueError(f"no DICOM file: {error}") from error
    if syntax in _UNREADABLE:
        raise ValueError(f"transfer syntax {UID(syntax).name}: explicit VR, little endian is needed")
    return Header(dataset, syntax, _pixels(dataset, file))


def _pixels(dataset: Dataset, file: BinaryIO) -> Pixels | None:
    """The pixel data element at which reading stopped."""
    position = file.tell()
    head = file.read(12)
    if len(head) < 12:
        return None
    group, element, vr, length = struct.unpack("<HH2s2xI", head)
    return Pixels(
        tag=f"{group:04X}{element:04X}",
        vr=vr.decode("ascii"),
        offset=position + 12,
        length=None if length == _UNDEFINED else length,
        frames=_integer(dataset, "NumberOfFrames", 1),
        rows=_integer(dataset, "Rows", 0),
        columns=_integer(dataset, "Columns", 0),
        samples=_integer(dataset, "SamplesPerPixel", 1),
        bits=_integer(dataset, "BitsAllocated", 8),
    )


def _integer(dataset: Dataset, keyword: str, default: int) -> int:
    value: Any = dataset.get(keyword)
    return default if value is None else int(value)


class _StoredFile(io.RawIOBase):
    """A stored file of which only what is read is fetched, from the disk or from object storage."""

    def __init__(self, store: Store, ref: FileRef) -> None:
        self.name = ref.sha256  # pydicom asks buffered files for one
        self._store = store
        self._ref = ref
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._ref.size}[whence]
        self._position = max(start + offset, 0)
        return self._position

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        length = min(len(view), self._ref.size - self._position)
        done = 0
        for piece in self._store.stream(self._ref, self._position, length) if length > 0 else ():
            view[done : done + len(piece)] = piece
            done += len(piece)
        self._position += done
        return done


def open_stored(store: Store, ref: FileRef) -> BinaryIO:
    """A stored file for reading, seekable."""
    return cast(BinaryIO, io.BufferedReader(_StoredFile(store, ref), BUFFER_BYTES))
