"""The HTTP API. ``create_app`` makes it; ``api.app:app`` is made when a server first asks for it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.concurrency import run_in_threadpool

from api.deliveries import routes as deliveries
from api.destinations import routes as destinations
from api.dicomweb import routes as dicomweb
from api.dicomweb.cors import ViewerOrigins
from api.http import errors
from api.http.auth import authenticate
from api.http.deps import Services
from api.http.documents import PREFIX
from api.http.guard import Guard
from api.http.head import Head
from api.http.requests import Requests
from api.http.slow import SlowBodies
from api.phantoms import routes as phantoms
from api.simulations import artifacts
from api.simulations import routes as simulations
from api.simulations.automatic import with_deliver
from api.site import catalog, health, metrics, page, reference
from api.studies import pins
from api.studies import routes as studies
from api.webhooks import routes as webhooks
from simcore import __version__
from simcore.spec import SimulationSpec
from simcore.study import StudySpec
from worker.messages import Messenger
from worker.settings import Settings
from worker.upkeep.courier import Courier
from worker.upkeep.garbage import Collector
from worker.upkeep.reaper import Reaper

DESCRIPTION = (
    "Simulation of digital breast tomosynthesis: a specification goes in, DICOM with known ground truth comes out. "
    "Errors are application/problem+json with a stable code."
)


def create_app(settings: Settings | None = None, messenger: Messenger | None = None, sweep: bool = True) -> FastAPI:
    """The application.

    settings: those of the environment where not given. messenger: the broker of the settings where not given.
    sweep: whether it sends and takes back lost cases every few seconds (any number of applications may).
    """
    chosen = settings or Settings.load()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        served = await run_in_threadpool(Services.open, chosen, messenger)
        app.state.services = served
        reaper = Reaper(chosen, served.jobs, served.fleet, served.messenger, served.deliveries)
        courier = Courier(chosen, served.webhooks)
        collector = Collector(chosen, served.jobs.engine, served.store)
        if sweep:
            reaper.start()
            courier.start()
            collector.start()
        async with dicomweb.serving(app, served, sweep):
            yield
        if sweep:
            await run_in_threadpool(reaper.stop)
            await run_in_threadpool(courier.stop)
            await run_in_threadpool(collector.stop)
        served.close()

    app = FastAPI(
        title="tomosim",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        responses={
            "default": {"description": "a problem", "content": {"application/problem+json": {"schema": _PROBLEM}}}
        },
    )
    errors.install(app)
    app.add_middleware(SlowBodies)
    app.add_middleware(Head)
    app.add_middleware(Guard)
    if chosen.viewer_origins:
        app.add_middleware(ViewerOrigins, origins=chosen.viewer_origins)
    app.add_middleware(Requests)
    for module in (
        simulations,
        artifacts,
        studies,
        phantoms,
        destinations,
        deliveries,
        webhooks,
        pins,
        catalog,
    ):
        app.include_router(module.router, prefix=PREFIX, dependencies=[Depends(authenticate)])
    app.include_router(dicomweb.router)
    app.include_router(health.router)
    app.include_router(metrics.router)
    app.include_router(page.router)
    app.include_router(reference.router)
    _describe_specification(app)
    return app


_PROBLEM = {"$ref": "#/components/schemas/Problem"}


def _describe_specification(app: FastAPI) -> None:
    """Adds the documents that are read and written by hand to the OpenAPI description."""
    generate = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            description = generate()
            schemas = description.setdefault("components", {}).setdefault("schemas", {})
            for model in (SimulationSpec, StudySpec, errors.Problem):
                schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
                schemas.update(schema.pop("$defs", {}))
                schemas[model.__name__] = schema
            for title, plain in (("PostedSimulation", "SimulationSpec"), ("PostedStudy", "StudySpec")):
                schemas[title] = with_deliver(title, schemas[plain])
            for body in _bodies(description):
                schemas.update(body.pop("$defs", {}))
            app.openapi_schema = description
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _bodies(description: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The schemas of all bodies."""
    for operations in description["paths"].values():
        for operation in operations.values():
            for content in operation.get("requestBody", {}).get("content", {}).values():
                yield content["schema"]


def __getattr__(name: str) -> FastAPI:
    if name == "app":
        return create_app()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
