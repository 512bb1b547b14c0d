"""WADO-RS: rendered frames and thumbnails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import anyio
from fastapi import APIRouter, Request, Response
from pydicom.uid import BreastTomosynthesisImageStorage

from api.dicomweb.accept import RELATED, choose_picture, not_acceptable
from api.dicomweb.common import FrameList, Indexing, InstanceUID, SeriesUID, StudyUID, find, require_files
from api.dicomweb.frames import Frames
from api.dicomweb.multipart import Part, multipart_response, single_response
from api.dicomweb.rendering import Viewport, Wish, look, parse, picture
from api.dicomweb.retrieve import INSTANCE, SERIES, STUDY, entity_tag, frame_numbers, one_with_frames
from api.http.deps import Served, Services
from api.http.errors import ApiError
from worker.dicom_index.index import Instance

THUMBNAIL = Viewport(256, 256)

AT_ONCE = 2
"""Frames that are rendered at a time: each takes some 100 MB and a core."""

MOST_PICTURES = 10
"""Frames that one request may have rendered: they are held until they are sent."""

_BINARY: dict[str, Any] = {"schema": {"type": "string", "format": "binary"}}
_PICTURE: dict[str, Any] = {
    "response_class": Response,
    "responses": {
        200: {"content": {"image/jpeg": _BINARY, "image/png": _BINARY, RELATED: _BINARY}},
        304: {"description": "not changed"},
    },
    "openapi_extra": {
        "parameters": [
            {"name": name, "in": "query", "required": False, "description": text, "schema": schema}
            for name, text, schema in (
                (
                    "window",
                    "centre,width[,linear|linear-exact|sigmoid]",
                    {"type": "string", "pattern": "^-?[0-9]{1,9},[1-9][0-9]{0,8}(,(linear|linear-exact|sigmoid))?$"},
                ),
                (
                    "viewport",
                    "width,height[,x,y,w,h]",
                    {"type": "string", "pattern": "^[1-9][0-9]{0,2},[1-9][0-9]{0,2}$"},
                ),
                ("quality", "of JPEG", {"type": "integer", "minimum": 1, "maximum": 100}),
            )
        ]
    },
}

router = APIRouter()


@router.get(INSTANCE + "/rendered", **_PICTURE)
async def rendered_instance(
    study: StudyUID, series: SeriesUID, instance: InstanceUID, request: Request, served: Served, indexing: Indexing
) -> Response:
    """The frame that stands for the object, with its own window or that of ``window``."""

    def work() -> Response:
        frames = one_with_frames(served, indexing, study, series, instance)
        return _pictures(request, frames, [look(frames.store, frames.ref).representative], parse(request.query_params))

    return await _in_turn(request, work)


@router.get(INSTANCE + "/frames/{frames}/rendered", **_PICTURE)
async def rendered_frames(
    study: StudyUID,
    series: SeriesUID,
    instance: InstanceUID,
    frames: FrameList,
    request: Request,
    served: Served,
    indexing: Indexing,
) -> Response:
    """One frame, or several as multipart."""

    def work() -> Response:
        source = one_with_frames(served, indexing, study, series, instance)
        numbers = frame_numbers(frames, source.pixels.frames)
        return _pictures(request, source, numbers, parse(request.query_params))

    return await _in_turn(request, work)


@router.get(STUDY + "/thumbnail", **_PICTURE)
async def study_thumbnail(study: StudyUID, request: Request, served: Served, indexing: Indexing) -> Response:
    """A small picture of the study: of the volume, where there is one."""
    return await _in_turn(request, lambda: _thumbnail(request, served, find(indexing, study)))


@router.get(SERIES + "/thumbnail", **_PICTURE)
async def series_thumbnail(
    study: StudyUID, series: SeriesUID, request: Request, served: Served, indexing: Indexing
) -> Response:
    """A small picture of the series."""
    return await _in_turn(request, lambda: _thumbnail(request, served, find(indexing, study, series)))


@router.get(INSTANCE + "/thumbnail", **_PICTURE)
async def instance_thumbnail(
    study: StudyUID, series: SeriesUID, instance: InstanceUID, request: Request, served: Served, indexing: Indexing
) -> Response:
    """A small picture of the object."""
    return await _in_turn(request, lambda: _thumbnail(request, served, find(indexing, study, series, instance)))


@router.get(INSTANCE + "/frames/{frames}/thumbnail", **_PICTURE)
async def frame_thumbnail(
    study: StudyUID,
    series: SeriesUID,
    instance: InstanceUID,
    frames: FrameList,
    request: Request,
    served: Served,
    indexing: Indexing,
) -> Response:
    """A small picture of one frame."""

    def work() -> Response:
        source = one_with_frames(served, indexing, study, series, instance)
        numbers = frame_numbers(frames, source.pixels.frames)
        return _pictures(request, source, numbers, _small(request))

    return await _in_turn(request, work)


async def _in_turn(request: Request, work: Callable[[], Response]) -> Response:
    """Runs ``work`` in a thread, few at a time, so that pictures leave room for everything else."""
    limiter: anyio.CapacityLimiter = request.app.state.rendering
    return await anyio.to_thread.run_sync(work, limiter=limiter)


def _small(request: Request) -> Wish:
    wish = parse(request.query_params)
    return wish if wish.viewport is not None else replace(wish, viewport=THUMBNAIL)


def _thumbnail(request: Request, served: Services, instances: list[Instance]) -> Response:
    with_pixels = [item for item in instances if item.pixels is not None]
    if not with_pixels:
        raise ApiError(404, "no-pixel-data", "nothing here has pixel data")
    volumes = [item for item in with_pixels if item.sop_class == BreastTomosynthesisImageStorage]
    chosen = (volumes or with_pixels)[0]
    require_files(served, [chosen])
    frames = Frames(served.store, chosen)
    return _pictures(request, frames, [look(frames.store, frames.ref).representative], _small(request))


def _pictures(request: Request, frames: Frames, numbers: list[int], wish: Wish) -> Response:
    kind, multipart = choose_picture(request)
    if len(numbers) > MOST_PICTURES:
        raise ApiError(400, "bad-frames", f"{len(numbers)} frames: at most {MOST_PICTURES} are rendered for a request")
    if len(numbers) > 1 and not multipart:
        raise not_acceptable(f'{RELATED}; type="{kind}"; one frame at a time without multipart')
    shown = look(frames.store, frames.ref)
    tag = entity_tag(frames.instance.file.sha256, kind, numbers, wish)

    def part(number: int) -> Part:
        return Part.of(kind, picture(frames.array(number), shown, number, wish, kind))

    if not multipart:
        return single_response(request, part(numbers[0]), tag)
    return multipart_response(request, [part(number) for number in numbers], kind, tag)
