"""How the client that waits asks: requests that are tried again, pages, events, files.

Made from ``async_transport.py`` by ``python -m tomosim.client.twin``: change that one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import httpx

from tomosim.client import calls, common, errors, files
from tomosim.client.calls import Call
from tomosim.client.common import Deadline
from tomosim.client.files import Downloaded
from tomosim.client.retrying import Retrying
from tomosim.client.streams import CaseEvent, EventParser
from tomosim_contract.names import FINAL_STATES
from tomosim_contract.simulations import ArtifactResource

T = TypeVar("T")


class Transport:
    """The connection to one service. raises from every method: ServiceError"""

    def __init__(
        self,
        url: str | None = None,
        *,
        api_key: str | None = None,
        timeout_seconds: float = 60.0,
        retrying: Retrying | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self.url = common.url_of(url)
        self.timeout_seconds = timeout_seconds
        self.retrying = retrying or Retrying()
        self._http = httpx.Client(
            base_url=self.url, headers=common.headers(api_key), timeout=timeout_seconds, transport=transport
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        self._http.close()

    def _save(self, path: str, target: Path) -> int:
        """Writes an answer that cannot be gone on with to a file, whole or not at all."""
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(target.name + ".partial")
        with open(partial, "wb") as file:
            try:
                with self._open("GET", path) as response:
                    for chunk in response.iter_bytes():
                        file.write(chunk)
            except httpx.HTTPError as error:
                partial.unlink()
                raise errors.from_transport(self.url, error) from error
        partial.replace(target)
        return target.stat().st_size

    def _do(
        self, call: Call[T], content: Callable[[], Iterator[bytes]] | None = None, repeatable: bool | None = None
    ) -> T:
        """Sends a request, again where that may help. raises: ServiceError"""
        again = call.repeatable if repeatable is None else repeatable
        number = 0
        while True:
            number += 1
            try:
                response = self._http.request(
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
            time.sleep(pause)

    def _pages(self, page: Callable[[Any], Call[Any]]) -> Iterator[Any]:
        cursor = None
        while True:
            batch = self._do(page(cursor))
            yield from batch.items
            cursor = batch.next
            if cursor is None:
                return

    @contextmanager
    def _open(self, method: str, path: str, **request: Any) -> Iterator[httpx.Response]:
        """An answer that is read piece by piece. raises: ServiceError; httpx.HTTPError where no answer came"""
        number = 0
        while True:
            number += 1
            with self._http.stream(method, path, **request) as response:
                if not response.is_error:
                    yield response
                    return
                response.read()
            pause = self.retrying.after_response(number, response)
            if pause is None:
                raise errors.from_response(response)
            time.sleep(pause)

    def _events(self, simulation_id: str, after: int, deadline: Deadline) -> Iterator[CaseEvent]:
        path = f"/v1/simulations/{simulation_id}/events"
        failures = 0
        while True:
            parser = EventParser()
            headers = {"Last-Event-ID": str(after)} if after else {}
            timeout = deadline.stream_timeout(self.timeout_seconds)
            try:
                with self._open("GET", path, headers=headers, timeout=timeout) as response:
                    for line in response.iter_lines():
                        deadline.check(simulation_id)
                        if event := parser.feed(line):
                            after, failures = event.sequence, 0
                            yield event
                if self._has_ended(simulation_id):
                    return
            except httpx.HTTPError as error:
                deadline.check(simulation_id)
                failures += 1
                if failures >= self.retrying.attempts:
                    raise errors.from_transport(self.url, error) from error
                time.sleep(self.retrying.pause(failures))

    def _has_ended(self, simulation_id: str) -> bool:
        return self._do(calls.simulation(simulation_id)).state in FINAL_STATES

    def _fetch(self, item: ArtifactResource, folder: Path) -> Downloaded:
        target = files.target_of(folder, item.name)
        if files.is_there(target, item.size, item.sha256):
            return Downloaded(item.name, target, item.size, kept=True)
        with files.Partial(target, item.sha256) as partial:
            number = 0
            while True:
                number += 1
                try:
                    with self._open("GET", item.href, headers=partial.headers()) as response:
                        partial.begin(response)
                        for chunk in response.iter_bytes():  # with a size, what came before an error would be lost
                            partial.write(chunk)
                    return Downloaded(item.name, target, partial.finish())
                except httpx.HTTPError as error:
                    pause = self.retrying.after_error(number, error, repeatable=True)
                    if pause is None:
                        raise errors.from_transport(self.url, error) from error
                    time.sleep(pause)
