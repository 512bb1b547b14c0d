"""The files of a delivery: what they are, and how they are decompressed for a peer that wants that."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydicom import dcmread
from pydicom.errors import InvalidDicomError
from pydicom.filereader import read_file_meta_info
from pydicom.uid import UID, ExplicitVRLittleEndian, ImplicitVRLittleEndian

from tomosim_contract.destination import TRANSFER_SYNTAX_UIDS, Destination
from worker.delivery.association import Kind

UNCOMPRESSED = (str(ExplicitVRLittleEndian), str(ImplicitVRLittleEndian))


class FileError(Exception):
    """A file cannot be sent; the message says why."""


@dataclass(frozen=True)
class Header:
    """A file's meta information."""

    kind: Kind
    sop_instance: str


def read_header(path: Path) -> Header:
    """raises: FileError where the file is gone or no DICOM"""
    try:
        meta = read_file_meta_info(path)
        kind = Kind(str(meta.MediaStorageSOPClassUID), str(meta.TransferSyntaxUID))
        return Header(kind, str(meta.MediaStorageSOPInstanceUID))
    except FileNotFoundError:
        raise FileError("the file is not in the store any more") from None
    except (OSError, InvalidDicomError, AttributeError, EOFError, ValueError) as error:
        raise FileError(f"not a DICOM file that can be sent ({error})") from None


def read_series(path: Path) -> str | None:
    """Series Instance UID of a file; None where it has none or is not readable."""
    try:
        dataset = dcmread(path, stop_before_pixels=True, specific_tags=["SeriesInstanceUID"])
        return str(dataset.SeriesInstanceUID)
    except (OSError, InvalidDicomError, AttributeError, EOFError, ValueError):
        return None


def offered(kind: Kind, destination: Destination) -> list[str]:
    """The transfer syntaxes in which a file may go to a destination, the preferred first."""
    possible = [kind.transfer_syntax, *(s for s in UNCOMPRESSED if s != kind.transfer_syntax)]
    syntaxes = [TRANSFER_SYNTAX_UIDS[name] for name in destination.transfer_syntaxes]
    return [syntax for syntax in syntaxes if syntax in possible] or possible


def converted(path: Path, transfer_syntax: str, target: Path) -> Path:
    """Writes a file in an uncompressed transfer syntax to ``target``. Needs memory for its pixels.

    raises: FileError
    """
    try:
        dataset = dcmread(path)
        if dataset.file_meta.TransferSyntaxUID.is_compressed:
            dataset.decompress(generate_instance_uid=False)
        dataset.file_meta.TransferSyntaxUID = UID(transfer_syntax)
        dataset.save_as(
            target,
            implicit_vr=transfer_syntax == str(ImplicitVRLittleEndian),
            little_endian=True,
            enforce_file_format=True,
        )
    except MemoryError:
        raise FileError("it needs more memory to be decompressed than there is") from None
    except Exception as error:  # pydicom's handlers raise what their codecs raise
        raise FileError(f"it cannot be decompressed ({error})") from error
    return target
