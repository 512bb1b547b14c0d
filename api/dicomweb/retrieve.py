"""WADO-RS: whole objects, metadata, frames and bulk data, streamed from the store."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from api.dicomweb.accept import (
    DEFAULT_SYNTAX,
    DICOM,
    JSON,
    OCTETS,
    RELATED,
    Representation,
    choose_dicom,
    choose_json,
    choose_pixels,
    not_acceptable,
)
from api.dicomweb.common import FrameList, Indexing, InstanceUID, SeriesUID, StudyUID, find, require_files, resource_url
from api.dicomweb.frames import Frames, uncompressed_head
from api.dicomweb.metadata import bulk_value, is_pixel_data, metadata_json
from api.dicomweb.multipart import Part, multipart_response, single_response
from api.dicomweb.query import FRAMES
from api.http.deps import Served, Services
from api.http.errors import MAX_SHOWN, ApiError
from worker.dicom_index.index import Instance
from worker.dicom_index.indexer import Indexer

router = APIRouter()

STUDY = "/studies/{study}"
SERIES = STUDY + "/series/{series}"
INSTANCE = SERIES + "/instances/{instance}"

_BINARY: dict[str, Any] = {"schema": {"type": "string", "format": "binary"}}
_DICOM: dict[int | str, Any] = {
    200: {"content": {RELATED: _BINARY, DICOM: _BINARY}},
    206: {"description": "the range that was asked for"},
    304: {"description": "not changed"},
}
_OCTETS: dict[int | str, Any] = {
    200: {"content": {RELATED: _BINARY, OCTETS: _BINARY}},
    206: {"description": "the range that was asked for"},
    304: {"description": "not changed"},
}
_METADATA: dict[int | str, Any] = {
    200: {"content": {JSON: {"schema": {"type": "array", "items": {"type": "object"}}}}},
    304: {"description": "not changed"},
}


@router.get(STUDY, response_class=Response, responses=_DICOM)
def retrieve_study(study: StudyUID, request: Request, served: Served, indexing: Indexing) -> Response:
    """All objects of a study."""
    return _objects(request, served, find(indexing, study))


@router.get(SERIES, response_class=Response, responses=_DICOM)
def retrieve_series(
    study: StudyUID, series: SeriesUID, request: Request, served: Served, indexing: Indexing
) -> Response:
    """All objects of a series."""
    return _objects(request, served, find(indexing, study, series))


@router.head(INSTANCE, include_in_schema=False)
@router.get(INSTANCE, response_class=Response, responses=_DICOM)
def retrieve_instance(
    study: StudyUID, series: SeriesUID, instance: InstanceUID, request: Request, served: Served, indexing: Indexing
) -> Response:
    """One object; as application/dicom without multipart it has byte ranges."""
    return _objects(request, served, find(indexing, study, series, instance))


@router.get(STUDY + "/metadata", response_class=Response, responses=_METADATA)
def study_metadata(study: StudyUID, request: Request, served: Served, indexing: Indexing) -> Response:
    """Attributes of all objects of a study."""
    return _metadata(request, served, find(indexing, study))


@router.get(SERIES + "/metadata", response_class=Response, responses=_METADATA)
def series_metadata(
    study: StudyUID, series: SeriesUID, request: Request, served: Served, indexing: Indexing
) -> Response:
    """Attributes of all objects of a series."""
    return _metadata(request, served, find(indexing, study, series))


@router.get(INSTANCE + "/metadata", response_class=Response, responses=_METADATA)
def instance_metadata(
    study: StudyUID, series: SeriesUID, instance: InstanceUID, request: Request, served: Served, indexing: Indexing
) -> Response:
    """Attributes of one object."""
    return _metadata(request, served, find(indexing, study, series, instance))


@router.head(INSTANCE + "/frames/{frames}", include_in_schema=False)
@router.get(INSTANCE + "/frames/{frames}", response_class=Response, responses=_OCTETS)
def retrieve_frames(
    study: StudyUID,
    series: SeriesUID,
    instance: InstanceUID,
    frames: FrameList,
    request: Request,
    served: Served,
    indexing: Indexing,
) -> Response:
    """Frames by number, separated by commas, the first one is 1."""
    source = one_with_frames(served, indexing, study, series, instance)
    numbers = frame_numbers(frames, source.pixels.frames)
    chosen = choose_pixels(request, source.instance.transfer_syntax, len(numbers))
    url = resource_url(request, study, series, instance)
    parts = [_frame(source, chosen, number, f"{url}/frames/{number}", len(numbers)) for number in numbers]
    return _pixels(request, source.instance, chosen, parts, frames)


@router.head(INSTANCE + "/bulkdata/{where:path}", include_in_schema=False)
@router.get(INSTANCE + "/bulkdata/{where:path}", response_class=Response, responses=_OCTETS)
def retrieve_bulk_data(
    study: StudyUID,
    series: SeriesUID,
    instance: InstanceUID,
    where: str,
    request: Request,
    served: Served,
    indexing: Indexing,
) -> Response:
    """The value of one attribute, at the address that the metadata give."""
    row = find(indexing, study, series, instance)[0]
    require_files(served, [row])
    url = f"{resource_url(request, study, series, instance)}/bulkdata/{where}"
    if is_pixel_data(row.pixels, where):
        return _pixel_data(request, Frames(served.store, row), url)
    value = bulk_value(served.store, row.file, where.upper()) if len(where) < 200 else None
    if value is None:
        raise ApiError(404, "bulk-data-not-found", f"the instance has no bulk data {where[:MAX_SHOWN]!r}")
    chosen = choose_pixels(request, DEFAULT_SYNTAX, 1)
    return _pixels(request, row, chosen, [Part.of(OCTETS, value, url)], where)


def one_with_frames(served: Services, indexing: Indexer, study: str, series: str, instance: str) -> Frames:
    """The frames of an instance. raises: ApiError 404, 410"""
    rows = find(indexing, study, series, instance)
    require_files(served, rows)
    return Frames(served.store, rows[0])


def frame_numbers(text: str, frames: int) -> list[int]:
    """The numbers of "1,2,5". raises: ApiError 400 where it is no such list, 404 where there is no such frame"""
    if not FRAMES.fullmatch(text):
        raise ApiError(
            400, "bad-frames", f"frames = {text[:MAX_SHOWN]!r}: numbers from 1 on, separated by commas, are allowed"
        )
    numbers = [int(part) for part in text.split(",")]
    if len(set(numbers)) < len(numbers):
        raise ApiError(400, "bad-frames", f"frames = {text[:MAX_SHOWN]!r}: each frame can be asked for once")
    for number in numbers:
        if not 1 <= number <= frames:
            raise ApiError(404, "frame-not-found", f"frame {number}: the instance has the frames 1 to {frames}")
    return numbers


def entity_tag(*what: object) -> str:
    """A tag that changes with any of its parts."""
    return hashlib.sha256("\n".join(map(str, what)).encode()).hexdigest()[:32]


def _objects(request: Request, served: Services, instances: list[Instance]) -> Response:
    require_files(served, instances)
    chosen = choose_dicom(request, {item.transfer_syntax for item in instances}, len(instances))
    parts = [_object(served, chosen, item) for item in instances]
    tag = entity_tag(chosen, *(item.file.sha256 for item in instances))
    if chosen.multipart:
        return multipart_response(request, parts, DICOM, tag)
    return single_response(request, parts[0], tag)


def _object(served: Services, chosen: Representation, item: Instance) -> Part:
    if chosen.stored or item.pixels is None or item.pixels.length is not None:
        kind = f"{DICOM}; transfer-syntax={item.transfer_syntax}"
        return Part(kind, item.file.size, lambda first, length: served.store.stream(item.file, first, length))
    head = uncompressed_head(served.store, item)
    frames = Frames(served.store, item)

    def chunks(first: int, length: int) -> Iterator[bytes]:
        if first < len(head):
            piece = head[first : first + length]
            yield piece
            first, length = len(head), length - len(piece)
        if length > 0:
            yield from frames.chunks(first - len(head), length)

    return Part(f"{DICOM}; transfer-syntax={DEFAULT_SYNTAX}", len(head) + frames.plain_length, chunks)


def _metadata(request: Request, served: Services, instances: list[Instance]) -> Response:
    kind = choose_json(request)
    require_files(served, instances)

    def body() -> Iterator[bytes]:
        for number, item in enumerate(instances):
            url = resource_url(request, item.study, item.series, item.uid)
            yield (b"," if number else b"[") + metadata_json(served.store, item.file, url)
        yield b"]"

    return StreamingResponse(body(), headers={"Cache-Control": "private, no-cache"}, media_type=kind)


def _frame(frames: Frames, chosen: Representation, number: int, location: str, count: int) -> Part:
    if chosen.stored and frames.compressed:
        kind = f"{chosen.media_type}; transfer-syntax={frames.instance.transfer_syntax}"
        if count == 1:
            return Part.of(kind, frames.stored(number), location)
        return Part(kind, None, lambda first, length: iter([frames.stored(number)]), location)
    size = frames.pixels.frame_bytes
    kind = f"{OCTETS}; transfer-syntax={DEFAULT_SYNTAX}"
    if frames.pixels.frame_bits % 8:
        return Part(kind, size, lambda first, length: iter([frames.plain(number)[first : first + length]]), location)
    start = (number - 1) * size
    return Part(kind, size, lambda first, length: frames.chunks(start + first, length), location)


def _pixel_data(request: Request, frames: Frames, url: str) -> Response:
    chosen = choose_pixels(request, frames.instance.transfer_syntax, 1)
    if chosen.stored and frames.compressed:
        count = frames.pixels.frames
        if count > 1 and not chosen.multipart:
            raise not_acceptable(f'{RELATED}; type="{chosen.media_type}": the {count} frames are compressed one by one')
        parts = [_frame(frames, chosen, number + 1, url, count) for number in range(count)]
    else:
        kind = f"{OCTETS}; transfer-syntax={DEFAULT_SYNTAX}"
        parts = [Part(kind, frames.plain_length, frames.chunks, url)]
    return _pixels(request, frames.instance, chosen, parts, frames.pixels.tag)


def _pixels(request: Request, item: Instance, chosen: Representation, parts: list[Part], what: str) -> Response:
    tag = entity_tag(chosen, item.file.sha256, what)
    if chosen.multipart:
        return multipart_response(request, parts, chosen.media_type, tag)
    return single_response(request, parts[0], tag)
