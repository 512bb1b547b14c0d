"""/v1/studies/{id}/cases, /manifest, /archive, /events: what has become of the cases."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

import anyio
from fastapi import APIRouter, Depends, Header, Query, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse

from api.http import streams
from api.http.auth import Read
from api.http.deps import Served, Services, StudyIdentifier
from api.http.errors import ApiError
from api.http.pages import Page, page_of
from api.simulations.artifacts import (
    ZIP,
    Member,
    Only,
    archive,
    chosen_files,
    content_member,
    file_members,
    manifest_bytes,
)
from api.studies import tables
from api.studies.resources import case_resource, folder_name, study_resource
from tomosim_contract.names import State
from tomosim_contract.studies import CasePage
from worker.records.database import AWAY
from worker.records.retention import ExpiredError
from worker.records.rows import NotFoundError
from worker.records.studies import Studies, Study

POLL_SECONDS = 1.0

_MANIFEST: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/json": {}, "text/csv": {"schema": {"type": "string"}}}}
}

router = APIRouter(prefix="/{identifier}")


@router.get("/cases")
def list_cases(
    caller: Read,
    identifier: StudyIdentifier,
    served: Served,
    page: Annotated[Page, Depends(page_of(100, 1000))],
    state: Annotated[State | None, Query(description="only cases in this state")] = None,
) -> CasePage:
    """Its cases with their coordinates, in the order of their numbers."""
    served.studies.get(identifier)
    after = int(page.before[0]) if page.before else 0
    rows = served.studies.cases(identifier, page.rows, state, after)
    shown, following = page.shown(rows, lambda row: (float(row.study_number or 0), identifier))
    return CasePage(items=[case_resource(row, time.time()) for row in shown], next=following)


@router.get("/manifest", response_class=Response, responses=_MANIFEST)
def get_manifest(
    caller: Read,
    identifier: StudyIdentifier,
    served: Served,
    format: Annotated[Literal["json", "csv"] | None, Query(description="as Accept says where not given")] = None,
    accept: Annotated[str | None, Header()] = None,
) -> Response:
    """All cases: coordinates, states, results, files with their digests (JSON); or one line a case (CSV).

    A case whose files have expired has none, and ``expired`` is true.
    """
    row = served.studies.get(identifier)
    now = time.time()
    if (format or tables.preferred(accept)) == "json":
        body = manifest_json(served, row, now)
        return StreamingResponse(body, media_type="application/json", headers={"Vary": "Accept"})
    headers = {"Content-Disposition": f'attachment; filename="study-{identifier}.csv"', "Vary": "Accept"}
    content = tables.csv_table(row, served.studies.cases(identifier), now)
    return Response(content, media_type="text/csv; charset=utf-8", headers=headers)


@router.get("/archive", response_class=StreamingResponse, responses=ZIP)
def get_archive(
    caller: Read,
    identifier: StudyIdentifier,
    served: Served,
    only: Only = None,
) -> StreamingResponse:
    """The files of the cases that have succeeded so far, one folder a case, as a zip archive made while it is sent.

    Cases whose files have expired are left out; missing.txt names them, as well as files that are gone meanwhile.
    """
    row = served.studies.get(identifier)
    if not row.counts.get("succeeded"):
        raise ApiError(409, "not-finished", f"no case of the study has succeeded yet; it is {row.state}")
    now = time.time()
    if not served.studies.has_files(identifier, now):
        raise ExpiredError(f"the files of study {identifier}")
    return archive(_members(served, row, only, now), f"study-{identifier}.zip")


@router.get("/events", response_class=StreamingResponse, responses=streams.STREAM)
def events(caller: Read, identifier: StudyIdentifier, served: Served) -> StreamingResponse:
    """An event ``study`` with state and counts now and after every change, until all cases have ended."""
    served.studies.get(identifier)
    return streams.answer(_stream(served.studies, identifier))


def manifest_json(served: Services, study: Study, now: float) -> Iterator[str]:
    """The manifest, case by case, so that a large one never is in memory as a whole."""
    resource = study_resource(study, served.studies.document(study.id)).model_dump(mode="json")
    head = json.dumps({"schema": "tomosim-study-manifest/1", "study": resource}, indent=1)
    yield head.removesuffix("\n}") + ',\n "cases": ['
    manifests = served.studies.manifests(study.id, now)
    number, manifest = next(manifests, (0, {}))
    for position, case in enumerate(served.studies.cases(study.id)):
        entry = case_resource(case, now).model_dump(mode="json")
        while number and number < entry["number"]:
            number, manifest = next(manifests, (0, {}))
        if number == entry["number"]:
            entry |= {"stages": _stages(manifest), "files": manifest["files"]}
        yield (",\n  " if position else "\n  ") + json.dumps(entry)
    yield "\n ]\n}\n"


def _stages(manifest: dict[str, Any]) -> list[dict[str, Any]]:
    names = ("name", "key", "cached", "seconds")
    return [{name: stage[name] for name in names if name in stage} for stage in manifest.get("stages", ())]


def _members(served: Services, study: Study, only: str | None, now: float) -> Iterator[Member]:
    when = datetime.fromtimestamp(now, UTC)
    cases = served.studies.cases(study.id)
    yield content_member("manifest.json", "".join(manifest_json(served, study, now)).encode(), when)
    yield content_member("manifest.csv", tables.csv_table(study, cases, now).encode(), when)
    missing = [f"{folder_name(case.study_number or 0)}/" for case in cases if case.is_expired(now)]
    for number, manifest in served.studies.manifests(study.id, now):
        folder = f"{folder_name(number)}/"
        yield content_member(f"{folder}manifest.json", manifest_bytes(manifest), when)
        chosen = chosen_files(manifest, only)
        there = {name: ref for name, ref in chosen.items() if served.store.has(ref)}
        missing += [folder + name for name in chosen if name not in there]
        yield from file_members(served.store, there, when, folder)
    if missing:
        yield content_member("missing.txt", "".join(f"{name}\n" for name in missing).encode(), when)


async def _stream(studies: Studies, identifier: str) -> AsyncIterator[str]:
    yield f"retry: {streams.RECONNECT_MILLISECONDS}\n\n"
    last = ""
    spoke = time.monotonic()
    while True:
        try:
            study = await run_in_threadpool(studies.get, identifier)
        except NotFoundError:
            return
        except AWAY:
            await anyio.sleep(POLL_SECONDS)
            continue
        data = json.dumps({"state": study.state, "counts": study.counts, "finished_cases": study.finished_cases})
        if data != last:
            last, spoke = data, time.monotonic()
            yield f"event: study\ndata: {data}\n\n"
        if study.is_final:
            return
        if time.monotonic() - spoke > streams.HEARTBEAT_SECONDS:
            spoke = time.monotonic()
            yield ": still here\n\n"
        await anyio.sleep(POLL_SECONDS)
