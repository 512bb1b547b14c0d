"""Uploaded phantoms in the store: the file as an object, and a note about it that outlives every collection.

objects/ab/<sha256>        the file
phantoms/<sha256>.json     the note; as long as it is there the object is in use
"""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

from pydantic import ValidationError

from simcore.core.errors import SpecError
from simcore.core.store import FileRef, Store, canonical
from simcore.phantom.upload.header import refuse
from simcore.phantom.upload.joining import join, two_files
from simcore.phantom.upload.loading import survey
from simcore.phantom.upload.reading import Reading
from simcore.phantom.upload.spec import Axes, UploadedPhantom

FOLDER = "phantoms"
SCHEMA = "tomosim-phantom/1"


@dataclass(frozen=True)
class Upload:
    """A file in the store.

    name: what it was called. values: voxels of every value {value: count}.
    phantom: the part of a specification that uses it.
    """

    sha256: str
    size: int
    name: str
    format: str
    values: dict[str, int]
    phantom: dict[str, Any]
    schema: str = field(default=SCHEMA)

    @property
    def ref(self) -> FileRef:
        return FileRef(self.sha256, self.size)

    @property
    def spec(self) -> UploadedPhantom:
        """raises: pydantic.ValidationError where the note was changed by hand"""
        return UploadedPhantom.model_validate_json(json.dumps(self.phantom))


def add_file(store: Store, path: Path, reading: Reading | None = None) -> Upload:
    """Copies a file of any format into the store, a header and the voxels beside it (.mhd, .nhdr) as one.

    raises: SpecError where it cannot be read or holds values without a tissue.
    """
    reading = reading or Reading()
    try:
        path.open("rb").close()
    except OSError as error:
        raise SpecError(f"{path} cannot be read: {error.strerror}", code="upload-not-readable") from error
    voxels, header = two_files(path) or (path, None)
    with store.workspace() as folder:
        target = folder / "upload"
        if header is None:
            shutil.copyfile(voxels, target)
            return add_received(store, target, path.name, reading)
        with open(voxels, "rb") as source, open(target, "wb") as file:
            join(header, source, file)
        return _add(store, target, path.name, reading, header.axes)


def add_received(store: Store, received: Path, name: str, reading: Reading) -> Upload:
    """As ``add_file`` for one file in a workspace of the store, which is moved, not copied."""
    if reading.raw is None:
        return _add(store, received, name, reading, None)
    joined = received.with_name("joined")
    with open(received, "rb") as source, open(joined, "wb") as target:
        header = reading.raw.header(source)
        join(header, source, target)
    return _add(store, joined, name, reading, header.axes)


def is_digest(text: str) -> bool:
    """Whether a text can be a digest; nothing else is made a part of a path."""
    return re.fullmatch("[0-9a-f]{64}", text) is not None


def get(store: Store, sha256: str) -> Upload | None:
    """The note of an upload, or None where there is none or its file is gone."""
    try:
        found = Upload(**json.loads(store.read_document(FOLDER, f"{sha256}.json") or b"{}"))
    except (ValueError, TypeError):
        return None
    return found if store.has(found.ref) else None


def uploads(store: Store) -> list[Upload]:
    """All uploads, by digest."""
    found = (get(store, name.removesuffix(".json")) for name in store.documents(FOLDER))
    return [upload for upload in found if upload is not None]


def open_file(store: Store, spec: UploadedPhantom) -> IO[bytes]:
    """The file of ``spec``. raises: SpecError where it was never added"""
    upload = require(store, spec)
    return open(store.path(upload.ref), "rb")


def require(store: Store, spec: UploadedPhantom) -> Upload:
    """The note of the file of ``spec``. raises: SpecError where it was never added, or has another shape"""
    upload = get(store, spec.sha256)
    if upload is None:
        message = "there is no such file here: add it with 'tomosim phantom add' or POST /v1/phantoms"
        raise SpecError(
            f"phantom.sha256 = {spec.sha256}: {message}",
            code="upload-not-found",
            problems=[{"field": "phantom.sha256", "value": spec.sha256, "message": message}],
        )
    if tuple(upload.phantom["shape"]) != spec.shape:
        message = f"the file has {upload.phantom['shape']} voxels"
        raise SpecError(
            f"phantom.shape = {list(spec.shape)}: {message}",
            code="upload-mismatch",
            problems=[{"field": "phantom.shape", "value": None, "message": message}],
        )
    return upload


def _add(store: Store, path: Path, name: str, reading: Reading, axes: Axes | None) -> Upload:
    """axes: those of a header that is not in the file any more."""
    with open(path, "rb") as file:
        found = survey(file, reading.tissues)
    header = found.header
    spacing = reading.spacing_mm or header.spacing_mm
    if spacing is None:
        raise refuse("its header has no voxel size: give spacing_mm")
    axes = reading.axes or axes or header.axes
    try:
        phantom = UploadedPhantom(
            sha256=64 * "0",
            shape=header.shape,
            spacing_mm=spacing,
            axes=axes,
            tissues=reading.tissues,
            compressed=reading.compressed,
            extent_mm=found.extent_mm(spacing, axes),
        )
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise refuse(f"{'.'.join(map(str, first['loc']))} = {first['input']}: {first['msg']}") from None
    ref = store.add(path)
    values = {str(value): count for value, count in found.values.items()}
    part = phantom.with_(sha256=ref.sha256).model_dump(mode="json")
    upload = Upload(ref.sha256, ref.size, name, header.format, values, part)
    store.write_document(FOLDER, f"{upload.sha256}.json", canonical(asdict(upload)))
    return upload
