"""/v1/presets, /v1/schemas, /v1/service-info: what can be asked for."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.responses import JSONResponse
from pydantic import BaseModel

from api.http.auth import Read
from api.http.deps import Served
from api.http.documents import PREFIX
from api.http.errors import ApiError
from simcore import __version__, presets
from simcore.core.errors import SpecError
from simcore.phantom.upload.reading import Reading
from simcore.spec import SimulationSpec
from simcore.study import StudySpec
from tomosim_contract.catalog import Limits, Listing, PresetList, PresetResource, ServiceInfo
from tomosim_contract.names import QUEUES, STATES

router = APIRouter(tags=["catalog"])


class SchemaResponse(JSONResponse):
    """A JSON Schema."""

    media_type = "application/schema+json"


SCHEMAS: dict[str, type[BaseModel]] = {"simulation": SimulationSpec, "study": StudySpec, "reading": Reading}


@router.get("/presets")
def list_presets(caller: Read) -> PresetList:
    """The names of all presets."""
    return PresetList(items=[_preset(name) for name in presets.names()])


@router.get("/presets/{name}")
def get_preset(caller: Read, name: str) -> PresetResource:
    """One preset with its specification, ready to be posted."""
    try:
        specification = presets.get(name).model_dump(mode="json")
    except SpecError as error:
        raise ApiError(404, "preset-not-found", str(error)) from None
    return _preset(name).model_copy(update={"specification": specification})


def _preset(name: str) -> PresetResource:
    return PresetResource(name=name, description=presets.describe(name), href=f"{PREFIX}/presets/{name}")


@router.get("/schemas")
def list_schemas(caller: Read) -> Listing:
    """The documents whose JSON Schema is here."""
    return Listing(items=[{"name": name, "href": f"{PREFIX}/schemas/{name}"} for name in SCHEMAS])


@router.get("/schemas/{name}", response_class=SchemaResponse)
def get_schema(caller: Read, name: str) -> SchemaResponse:
    """JSON Schema (2020-12) of a document; quantities carry their ``unit``."""
    if name not in SCHEMAS:
        raise ApiError(404, "schema-not-found", f"there is no schema {name!r}; there are: {', '.join(SCHEMAS)}")
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **SCHEMAS[name].model_json_schema()}
    return SchemaResponse(schema)


@router.get("/service-info")
def service_info(caller: Read, served: Served) -> ServiceInfo:
    """Version and limits."""
    settings = served.settings
    return ServiceInfo(
        name="tomosim",
        version=__version__,
        api_version="v1",
        states=list(STATES),
        queues=list(QUEUES),
        limits=Limits(
            memory_bytes=settings.memory_limit,
            body_bytes=settings.body_limit_bytes,
            upload_bytes=settings.upload_limit_bytes,
            seconds=settings.job_timeout_seconds,
            attempts=settings.max_attempts,
            study_cases=settings.study_case_limit,
        ),
        threads_per_case=settings.threads,
        links={
            "simulations": f"{PREFIX}/simulations",
            "studies": f"{PREFIX}/studies",
            "phantoms": f"{PREFIX}/phantoms",
            "presets": f"{PREFIX}/presets",
            "schemas": f"{PREFIX}/schemas",
            "openapi": "/openapi.json",
        },
    )
