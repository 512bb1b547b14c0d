"""How the client asks: requests that are tried again, pages, events, files that are gone on with.

The one for programs that just wait, ``sync_transport.py``, is made from this file: ``python -m tomosim.client.twin``.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import anyio
import httpx

from tomosim.client import calls, common, errors, files
from tomosim.client.calls import Call
from tomosim.client.common import Deadline, run_in_thread
from tomosim.client.files import Downloaded
from tomosim.client.retrying import Retrying
from tomosim.client.streams import CaseEvent, EventParser
from tomosim_contract.names import FINAL_STATES
from tomosim_contract.simulations import ArtifactResource

T = TypeVar("T")


class AsyncTransport:
    """The connection to one service. raises from every method: ServiceError"""

    def __init__(
        self,
        url: str | None = None,
        *,
        api_key: str | None = None,
        timeout_seconds: float = 60.0,
        retrying: Retrying | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
    ) -> None:
        self.url = common.url_of(url)
        self.timeout_seconds = timeout_seconds
        self.retrying = retrying or Retrying()
        self._http = httpx.AsyncClient(
            base_url=self.url, headers=common.headers(api_key), timeout=timeout_seconds, transport=transport
        )

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        await self._http.aclose()

    async def _save(self, path: str, target: Path) -> int:
        """Writes an answer that cannot be gone on with to a file, whole or not at all."""
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(target.name + ".partial")
        with open(partial, "wb") as file:
            try:
                async with self._open("GET", path) as response:
                    async for chunk in response.aiter_bytes():
                        file.write(chunk)
            except httpx.HTTPError as error:
                partial.unlink()
                raise errors.from_transport(self.url, error) from error
        partial.replace(target)
        return target.stat().st_size

    async def _do(
        self, call: Call[T], content: Callable[[], AsyncIterator[bytes]] | None = None, repeatable: bool | None = None
    ) -> T:
        """Sends a request, again where that may help. raises: ServiceError"""
        again = call.repeatable if repeatable is None else repeatable
        number = 0
        while True:
            number += 1
            try:
                response = await self._http.request(
                    call.method,
                    call.path,
                    params=call.params,
                    json=call.json,
                    content=content() if content else None,
                    headers=call.headers,
                )
            except httpx.HTTPError as error:
                pause = self.retrying.after_error(number, error, again)
                if pause is None:
                    raise errors.from_transport(self.url, error) from error
            else:
                if not response.is_error:
                    return call.parse(response)
                pause = self.retrying.after_response(number, response) if content is None or again else None
                if pause is None:
                    raise errors.from_response(response)
            await anyio.sleep(pause)

    async def _pages(self, page: Callable[[Any], Call[Any]]) -> AsyncIterator[Any]:
        cursor = None
        while True:
            batch = await self._do(page(cursor))
            for item in batch.items:
                yield item
            cursor = batch.next
            if cursor is None:
                return

    @asynccontextmanager
    async def _open(self, method: str, path: str, **request: Any) -> AsyncIterator[httpx.Response]:
        """An answer that is read piece by piece. raises: ServiceError; httpx.HTTPError where no answer came"""
        number = 0
        while True:
            number += 1
            async with self._http.stream(method, path, **request) as response:
                if not response.is_error:
                    yield response
                    return
                await response.aread()
            pause = self.retrying.after_response(number, response)
            if pause is None:
                raise errors.from_response(response)
            await anyio.sleep(pause)

    async def _events(self, simulation_id: str, after: int, deadline: Deadline) -> AsyncIterator[CaseEvent]:
        path = f"/v1/simulations/{simulation_id}/events"
        failures = 0
        while True:
            parser = EventParser()
            headers = {"Last-Event-ID": str(after)} if after else {}
            timeout = deadline.stream_timeout(self.timeout_seconds)
            try:
                async with self._open("GET", path, headers=headers, timeout=timeout) as response:
                    async for line in response.aiter_lines():
                        deadline.check(simulation_id)
                        if event := parser.feed(line):
                            after, failures = event.sequence, 0
                            yield event
                if await self._has_ended(simulation_id):
                    return
            except httpx.HTTPError as error:
                deadline.check(simulation_id)
                failures += 1
                if failures >= self.retrying.attempts:
                    raise errors.from_transport(self.url, error) from error
                await anyio.sleep(self.retrying.pause(failures))

    async def _has_ended(self, simulation_id: str) -> bool:
        return (await self._do(calls.simulation(simulation_id))).state in FINAL_STATES

    async def _fetch(self, item: ArtifactResource, folder: Path) -> Downloaded:
        target = files.target_of(folder, item.name)
        if await run_in_thread(files.is_there, target, item.size, item.sha256):
            return Downloaded(item.name, target, item.size, kept=True)
        with await run_in_thread(files.Partial, target, item.sha256) as partial:
            number = 0
            while True:
                number += 1
                try:
                    async with self._open("GET", item.href, headers=partial.headers()) as response:
                        partial.begin(response)
                        async for (
                            chunk
                        ) in response.aiter_bytes():  # with a size, what came before an error would be lost
                            partial.write(chunk)
                    return Downloaded(item.name, target, partial.finish())
                except httpx.HTTPError as error:
                    pause = self.retrying.after_error(number, error, repeatable=True)
                    if pause is None:
                        raise errors.from_transport(self.url, error) from error
                    await anyio.sleep(pause)
