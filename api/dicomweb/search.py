"""QIDO-RS: searches for studies, series and instances, answered from the index alone."""

from __future__ import annotations

import json
from typing import Any

from fastapi import APIRouter, Request, Response
from pydicom.datadict import tag_for_keyword

from api.dicomweb import query as queries
from api.dicomweb.accept import JSON, choose_json
from api.dicomweb.common import Indexing, SeriesUID, StudyUID, base_url, resource_url, service_url
from worker.dicom_index.index import Condition, Found
from worker.dicom_index.indexer import Indexer
from worker.records.dicom import Level

router = APIRouter()


def _tags(*keywords: str) -> set[str]:
    return {f"{tag_for_keyword(keyword):08X}" for keyword in keywords}


# What the standard wants of every result (PS3.18, section 10.6.3.3), and the descriptions.
_USUAL: dict[Level, set[str]] = {
    "study": _tags(
        "StudyDate", "StudyTime", "AccessionNumber", "ModalitiesInStudy", "ReferringPhysicianName", "StudyDescription",
        "TimezoneOffsetFromUTC", "PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyInstanceUID",
        "StudyID", "NumberOfStudyRelatedSeries", "NumberOfStudyRelatedInstances",
    ),
    "series": _tags(
        "Modality", "TimezoneOffsetFromUTC", "SeriesDescription", "SeriesInstanceUID", "SeriesNumber",
        "NumberOfSeriesRelatedInstances",
    ),
    "instance": _tags(
        "SOPClassUID", "SOPInstanceUID", "TimezoneOffsetFromUTC", "InstanceNumber", "Rows", "Columns",
        "BitsAllocated", "NumberOfFrames",
    ),
}  # fmt: skip
_IDENTIFIERS = _tags("StudyInstanceUID", "SeriesInstanceUID", "SOPInstanceUID", "SpecificCharacterSet")

_DOCUMENTED: dict[str, Any] = {
    "parameters": [
        {
            "name": name,
            "in": "query",
            "required": False,
            "description": description,
            "schema": schema,
        }
        for name, description, schema in (
            ("limit", "results of one answer, at most 1000", {"type": "integer", "minimum": 1, "maximum": 10**9}),
            ("offset", "results to leave out", {"type": "integer", "minimum": 0, "maximum": 10**9}),
            (
                "includefield",
                "keywords or tags, separated by commas, or all",
                {"type": "string", "pattern": "^(all|([0-9A-F]{8}(,[0-9A-F]{8})*)?)$"},
            ),
            ("fuzzymatching", "true: a Warning, literal matching", {"type": "string", "enum": ["true", "false"]}),
            (
                "PatientID",
                "any attribute by keyword or tag; wildcards * and ?",
                {"type": "string", "pattern": r"^[^\x00-\x1f\x7f]{0,1024}$"},
            ),
        )
    ]
}
_RESPONSES: dict[int | str, Any] = {
    200: {"content": {JSON: {"schema": {"type": "array", "items": {"type": "object"}}}}},
}


@router.get("/studies", response_class=Response, responses=_RESPONSES, openapi_extra=_DOCUMENTED)
def search_studies(request: Request, indexing: Indexing) -> Response:
    """Studies, the newest first."""
    return _answer(request, indexing, "study", {})


@router.get("/series", response_class=Response, responses=_RESPONSES, openapi_extra=_DOCUMENTED)
def search_series(request: Request, indexing: Indexing) -> Response:
    """Series of all studies."""
    return _answer(request, indexing, "series", {})


@router.get("/instances", response_class=Response, responses=_RESPONSES, openapi_extra=_DOCUMENTED)
def search_instances(request: Request, indexing: Indexing) -> Response:
    """Instances of all studies."""
    return _answer(request, indexing, "instance", {})


@router.get("/studies/{study}/series", response_class=Response, responses=_RESPONSES, openapi_extra=_DOCUMENTED)
def search_series_of_study(study: StudyUID, request: Request, indexing: Indexing) -> Response:
    """Series of one study."""
    return _answer(request, indexing, "series", {"StudyInstanceUID": study})


@router.get("/studies/{study}/instances", response_class=Response, responses=_RESPONSES, openapi_extra=_DOCUMENTED)
def search_instances_of_study(study: StudyUID, request: Request, indexing: Indexing) -> Response:
    """Instances of one study."""
    return _answer(request, indexing, "instance", {"StudyInstanceUID": study})


@router.get(
    "/studies/{study}/series/{series}/instances",
    response_class=Response,
    responses=_RESPONSES,
    openapi_extra=_DOCUMENTED,
)
def search_instances_of_series(study: StudyUID, series: SeriesUID, request: Request, indexing: Indexing) -> Response:
    """Instances of one series."""
    return _answer(request, indexing, "instance", {"StudyInstanceUID": study, "SeriesInstanceUID": series})


def _answer(request: Request, indexing: Indexer, level: Level, path: dict[str, str]) -> Response:
    kind = choose_json(request)
    query = queries.parse(level, request.query_params.multi_items())
    query.conditions += [Condition(keyword, values=(uid,)) for keyword, uid in path.items()]
    indexing.catch_up()
    results, total = indexing.index.search(level, query.conditions, query.limit, query.offset)
    response = Response(media_type=kind)
    response.body = json.dumps([_result(request, query, path, item) for item in results]).encode()
    response.headers["Content-Length"] = str(len(response.body))
    remaining = total - query.offset - len(results)
    warnings = list(query.warnings)
    if results and remaining > 0:
        warnings.append(f"There are {remaining} additional results that can be requested")
        following = request.url.include_query_params(offset=query.offset + len(results), limit=query.limit)
        response.headers["Link"] = f'<{following.replace(netloc=base_url(request).netloc)}>; rel="next"'
    for text in warnings:
        response.headers.append("Warning", f"299 {service_url(request)}: {text}")
    response.headers["Cache-Control"] = "no-cache"
    return response


def _result(request: Request, query: queries.Query, path: dict[str, str], item: Found) -> dict[str, Any]:
    attributes = item.attributes
    if not query.include_all:
        tags = query.include | _IDENTIFIERS
        for level in _levels(query.level, path):
            tags |= _USUAL[level]
        attributes = {tag: attributes[tag] for tag in tags if tag in attributes}
    url = resource_url(request, item.study, item.series, item.instance)
    attributes |= {
        "00081190": {"vr": "UR", "Value": [url]},
        "00080056": {"vr": "CS", "Value": ["ONLINE"]},
    }
    return dict(sorted(attributes.items()))


def _levels(level: Level, path: dict[str, str]) -> list[Level]:
    """The levels whose usual attributes a result has: those above its own only where the path does not name them."""
    levels: list[Level] = [level]
    if level == "instance" and "SeriesInstanceUID" not in path:
        levels.append("series")
    if level != "study" and "StudyInstanceUID" not in path:
        levels.append("study")
    return levels
