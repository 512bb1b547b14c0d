"""What a file is that is no label volume of a known format, and what to do with it."""

from __future__ import annotations

import zipfile
from io import SEEK_END
from typing import IO

_READ = "it is no NRRD, MetaImage or NIfTI file"
_RAW = (
    "raw voxels need a header beside them (shape and voxel size): tomosim phantom add FILE --header header.json with "
    '{"shape": [slices, rows, columns], "spacing_mm": [1, 1, 1]}, over HTTP reading = {"raw": {...}}'
)
_CONVERT = "open it in 3D Slicer or ITK-SNAP and save the labels as .nrrd or .nii.gz"
_MAGIC = (
    (0, b"version https://git-lfs", "a pointer of Git LFS, not the file itself: 'git lfs pull' fetches it"),
    (128, b"DICM", f"a DICOM file: {_CONVERT}"),
    (
        0,
        b"\x93NUMPY",
        "a NumPy array: numpy.load(FILE).astype('uint16').tofile('labels.raw') in Python, then tomosim phantom add "
        'labels.raw --header header.json with {"shape": [slices, rows, columns], "spacing_mm": [1, 1, 1], '
        '"dtype": "uint16"}',
    ),
    (0, b"II*\0", f"a TIFF picture: {_CONVERT}"),
    (0, b"MM\0*", f"a TIFF picture: {_CONVERT}"),
    (0, b"II+\0", f"a TIFF picture: {_CONVERT}"),
    (0, b"\x89HDF\r\n", f"an HDF5 file (MATLAB 7.3, MINC 2): {_CONVERT}"),
    (0, b"MATLAB 5.0", "a MATLAB file: nrrdwrite or niftiwrite in MATLAB saves the array for us"),
    (0, b"\x89PNG", f"a PNG picture, one slice: {_CONVERT}"),
    (0, b"\xff\xd8\xff", f"a JPEG picture, whose labels are not exact: {_CONVERT}"),
    (0, b"# vtk", f"a VTK file: {_CONVERT}"),
    (0, b"<VTKFile", f"a VTK file: {_CONVERT}"),
    (0, b"BZh", "a bzip2 file: unpack it (bunzip2) and add what is in it"),
    (0, b"(\xb5/\xfd", "a zstd file: unpack it (unzstd) and add what is in it"),
    (0, b"\xfd7zXZ", "an xz file: unpack it (unxz) and add what is in it"),
    (0, b"7z\xbc\xaf", "a 7z archive: unpack it and add the label volume that is in it"),
    (257, b"ustar", "a tar archive: unpack it and add the label volume that is in it"),
)
_ZIP = b"PK\x03\x04"
_MOST_NAMES = 10
_MOST = 1 << 20
_END_BYTES = (1 << 16) + 64


def explain(head: bytes, file: IO[bytes], whole_gzip: bool) -> str:
    """A sentence for a file that begins with ``head``, once unpacked where ``whole_gzip``."""
    if not head:
        return f"{_READ}: it is empty"
    if head.startswith(_ZIP) and not whole_gzip:
        return f"{_READ} but a zip archive: {_zip(file)}"
    for at, magic, what in _MAGIC:
        if head[at : at + len(magic)] == magic:
            return f"{_READ} but {what}"
    if whole_gzip:
        return f"a gzip file that is no NRRD, MetaImage or NIfTI: {_RAW}"
    return f"{_READ}; {_RAW}"


def _zip(file: IO[bytes]) -> str:
    if not _has_short_directory(file):
        return "unpack it and add the label volume that is in it"
    try:
        with zipfile.ZipFile(file) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return "a damaged one; unpack it and add the label volume that is in it"
    shown = ", ".join(name[:80] for name in names[:_MOST_NAMES]) + (", ..." if len(names) > _MOST_NAMES else "")
    data = next((n for n in names if n.lower().endswith((".dat", ".raw", ".bin", ".vol"))), None)
    text = next((n for n in names if n.lower().endswith((".xml", ".json", ".txt"))), None)
    if data is None:
        return f"unpack it and add the label volume that is in it ({shown})"
    about = f" ({text[:80]} says them)" if text else ""
    return (
        f"it holds {shown}, as OpenVCT's phantoms do. Unpack it (unzip FILE.zip), write shape and voxel size{about} "
        f'into header.json, {{"shape": [slices, rows, columns], "spacing_mm": [1, 1, 1]}}, and add the voxels: tomosim '
        f"phantom add {data[:80]} --header header.json --tissue-map openvct, or a map with the tissue of each value"
    )


def _has_short_directory(file: IO[bytes]) -> bool:
    """Whether the list of names at the end of a zip archive is short enough to be read whole."""
    size = file.seek(0, SEEK_END)
    file.seek(max(0, size - _END_BYTES))
    tail = file.read(_END_BYTES)
    at = tail.rfind(b"PK\5\6")
    return (
        0 <= at <= len(tail) - 22
        and b"PK\6\7" not in tail
        and int.from_bytes(tail[at + 12 : at + 16], "little") < _MOST
    )
