"""All routes of /dicomweb, and what they need beside the services."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio
from fastapi import APIRouter, Depends, FastAPI
from fastapi.concurrency import run_in_threadpool

from api.dicomweb import rendered, retrieve, search
from api.dicomweb.common import PREFIX, reader
from api.http.deps import Services
from worker.dicom_index.index import DicomIndex
from worker.dicom_index.indexer import Indexer

router = APIRouter(prefix=PREFIX, tags=["dicomweb"], dependencies=[Depends(reader)])
for module in (search, retrieve, rendered):
    router.include_router(module.router)


@asynccontextmanager
async def serving(app: FastAPI, served: Services, sweep: bool) -> AsyncIterator[None]:
    """Gives ``app`` the index. sweep: whether it is filled every few seconds, or only when somebody searches."""
    indexer = Indexer(DicomIndex(served.jobs.engine), served.store)
    app.state.dicom_indexer = indexer
    app.state.rendering = anyio.CapacityLimiter(rendered.AT_ONCE)
    if sweep:
        indexer.start()
    yield
    if sweep:
        await run_in_threadpool(indexer.stop)
