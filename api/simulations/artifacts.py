"""/v1/simulations/{id}/artifacts, /archive, /manifest: the files of a case that succeeded."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from itertools import chain
from typing import Annotated, Any, Literal
from urllib.parse import quote

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import StreamingResponse
from stream_zip import NO_COMPRESSION_64, stream_zip

from api.http import files
from api.http.auth import Read
from api.http.deps import Identifier, Served, Services
from api.http.errors import ApiError
from api.simulations.resources import simulation_path
from simcore.store.hashing import FileRef
from simcore.store.store import Store
from tomosim_contract.simulations import ArtifactList, ArtifactResource

Json = dict[str, Any]

FILE_MODE = 0o100644

_BINARY: Json = {"schema": {"type": "string", "format": "binary"}}
_FILE_RESPONSES: dict[int | str, Json] = {
    200: {"content": dict.fromkeys(files.ALL_MEDIA_TYPES, _BINARY)},
    206: {"description": "the range that was asked for", "content": dict.fromkeys(files.ALL_MEDIA_TYPES, _BINARY)},
    304: {"description": "not changed"},
    410: {"description": "expired: not in the store any more"},
    412: {"description": "changed-meanwhile: If-Match names another tag"},
    416: {"description": "range-not-satisfiable"},
}

ZIP: dict[int | str, Json] = {200: {"content": {"application/zip": _BINARY}}}

Only = Annotated[Literal["dicom", "mechanics", "preview"] | None, Query(description="files of this kind alone")]

router = APIRouter(prefix="/simulations/{identifier}", tags=["results"])


@router.get("/artifacts")
def list_artifacts(caller: Read, identifier: Identifier, served: Served) -> ArtifactList:
    """Every file of the case with its size and digest."""
    manifest = finished_manifest(served, identifier)
    path = simulation_path(identifier)
    stages = _stage_of_files(manifest)
    items = [
        ArtifactResource(
            name=name,
            size=ref.size,
            sha256=ref.sha256,
            media_type=files.media_type(name),
            stage=stages.get(name),
            href=f"{path}/artifacts/{quote(name)}",
        )
        for name, ref in file_refs(manifest).items()
    ]
    links = {"simulation": path, "archive": f"{path}/archive", "manifest": f"{path}/manifest"}
    return ArtifactList(items=items, links=links)


@router.get("/artifacts/{name:path}", response_class=Response, responses=_FILE_RESPONSES)
def get_artifact(caller: Read, identifier: Identifier, name: str, served: Served, request: Request) -> Response:
    """One file; byte ranges are served. Its entity tag is its SHA-256: the content never changes."""
    refs = file_refs(finished_manifest(served, identifier))
    if name not in refs:
        raise ApiError(404, "artifact-not-found", f"the simulation has no file {name!r}")
    return files.file_response(request, served.store, refs[name], name)


@router.get("/manifest")
def get_manifest(caller: Read, identifier: Identifier, served: Served) -> Response:
    """Specification, seeds, versions, stage keys, seconds, and the digest of every file."""
    content = manifest_bytes(finished_manifest(served, identifier))
    return Response(content, media_type="application/json")


@router.get("/archive", response_class=StreamingResponse, responses=ZIP)
def get_archive(
    caller: Read,
    identifier: Identifier,
    served: Served,
    only: Only = None,
) -> StreamingResponse:
    """Files and manifest.json as a zip archive (zip64, stored), made while it is sent."""
    manifest = finished_manifest(served, identifier)
    refs = chosen_files(manifest, only)
    check_stored(served.store, refs)
    when = datetime.fromtimestamp(served.jobs.get(identifier).finished or 0.0, UTC)
    first = content_member("manifest.json", manifest_bytes(manifest), when)
    return archive(chain([first], file_members(served.store, refs, when)), f"tomosim-{identifier}.zip")


def finished_manifest(served: Services, identifier: str) -> Json:
    """The manifest of a case. raises: ApiError 409 not-finished where it has no results"""
    manifest = served.jobs.manifest(identifier)
    if manifest is None:
        state = served.jobs.get(identifier).state
        raise ApiError(409, "not-finished", f"the simulation is {state}; only one that succeeded has files")
    return manifest


def file_refs(manifest: Json) -> dict[str, FileRef]:
    """The files of a case by name."""
    return {name: FileRef(**ref) for name, ref in manifest["files"].items()}


def manifest_bytes(manifest: Json) -> bytes:
    """manifest.json as ``tomosim simulate`` writes it."""
    return (json.dumps(manifest, indent=1) + "\n").encode()


def _stage_of_files(manifest: Json) -> dict[str, str]:
    return {name: stage["name"] for stage in manifest.get("stages", ()) for name in stage.get("outputs", ())}


Member = tuple[str, datetime, int, Any, Iterator[bytes]]


def chosen_files(manifest: Json, only: str | None) -> dict[str, FileRef]:
    """The files of a case that one stage made, or all."""
    refs = file_refs(manifest)
    if only is None:
        return refs
    stages = _stage_of_files(manifest)
    return {name: ref for name, ref in refs.items() if stages.get(name) == only}


def check_stored(store: Store, refs: dict[str, FileRef], folder: str = "") -> None:
    """raises: ApiError 410 where a file is not in the store any more"""
    for name, ref in refs.items():
        if not store.has(ref):
            raise ApiError(410, "expired", f"{folder}{name} is not in the store any more: post the case again")


def archive(members: Iterable[Member], name: str) -> StreamingResponse:
    """The answer that is a zip archive, made while it is sent."""
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    content = stream_zip(members, chunk_size=files.CHUNK_BYTES)
    return StreamingResponse(content, media_type="application/zip", headers=headers)


def content_member(name: str, content: bytes, when: datetime) -> Member:
    """A file of an archive, from memory."""
    return name, when, FILE_MODE, NO_COMPRESSION_64(len(content), zlib.crc32(content)), iter([content])


def file_members(store: Store, refs: dict[str, FileRef], when: datetime, folder: str = "") -> Iterator[Member]:
    """Stored files as files of an archive."""
    for name, ref in refs.items():
        path = store.path(ref)  # on this machine: it is read twice
        checksum = 0
        for chunk in files.read_chunks(path):
            checksum = zlib.crc32(chunk, checksum)
        yield folder + name, when, FILE_MODE, NO_COMPRESSION_64(ref.size, checksum), files.read_chunks(path)
