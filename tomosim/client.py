"""A small client of the service, used by ``tomosim submit`` and free to use from Python."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import httpx

from simcore.core.errors import SimulationError
from simcore.spec import SimulationSpec

DEFAULT_URL = "http://127.0.0.1:8080"
FINAL_STATES = ("succeeded", "failed", "cancelled")


class ServiceError(SimulationError):
    """The service said no, or could not be reached. ``problem`` is its problem+json answer where there is one."""

    kind = "system"
    code = "service-error"

    def __init__(self, message: str, *, code: str | None = None, problem: dict[str, Any] | None = None) -> None:
        super().__init__(message, code=code)
        self.problem = problem or {}


class Client:
    """One service. Use as a context manager.

    with Client("http://127.0.0.1:8080") as client:
        case = client.wait(client.submit(spec)["id"])
        client.download(case["id"], Path("out"))
    """

    def __init__(self, url: str = DEFAULT_URL, timeout_seconds: float = 60.0) -> None:
        self.url = url.rstrip("/")
        self._http = httpx.Client(base_url=self.url, timeout=timeout_seconds)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._http.close()

    def submit(self, spec: SimulationSpec) -> dict[str, Any]:
        """Queues a case and returns its resource (id, state, ...).

        raises: ServiceError with the service's explanation where the specification is refused.
        """
        return self._json("POST", "/v1/simulations", json=spec.model_dump(mode="json"))

    def get(self, simulation_id: str) -> dict[str, Any]:
        """The state of a case."""
        return self._json("GET", f"/v1/simulations/{simulation_id}")

    def cancel(self, simulation_id: str) -> dict[str, Any]:
        return self._json("POST", f"/v1/simulations/{simulation_id}/cancel")

    def wait(
        self, simulation_id: str, watch: Callable[[dict[str, Any]], None] | None = None, every_seconds: float = 0.3
    ) -> dict[str, Any]:
        """The case in its final state; ``watch`` is called with the resource after every look."""
        while True:
            case = self.get(simulation_id)
            if watch:
                watch(case)
            if case["state"] in FINAL_STATES:
                return case
            time.sleep(every_seconds)

    def artifacts(self, simulation_id: str) -> list[dict[str, Any]]:
        """name, size and sha256 of every file of a finished case."""
        return list(self._json("GET", f"/v1/simulations/{simulation_id}/artifacts")["items"])

    def download(self, simulation_id: str, out: Path) -> Iterator[tuple[str, int]]:
        """Writes every file and manifest.json below ``out``; yields (name, bytes) after each.

        raises: ServiceError where a file arrives with another digest than announced.
        """
        for item in self.artifacts(simulation_id):
            name = item["name"]
            self._fetch(f"/v1/simulations/{simulation_id}/artifacts/{name}", out / name, item["sha256"])
            yield name, item["size"]
        self._fetch(f"/v1/simulations/{simulation_id}/manifest", out / "manifest.json", None)
        yield "manifest.json", (out / "manifest.json").stat().st_size

    def _fetch(self, path: str, target: Path, sha256: str | None) -> None:
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(target.name + ".partial")
        content = hashlib.sha256()
        try:
            with self._http.stream("GET", path) as response, open(partial, "wb") as f:
                if response.is_error:
                    response.read()
                    raise self._problem(response)
                for chunk in response.iter_bytes(1 << 20):
                    content.update(chunk)
                    f.write(chunk)
        except httpx.HTTPError as error:
            raise ServiceError(f"{self.url}{path}: {error}") from error
        if sha256 is not None and content.hexdigest() != sha256:
            partial.unlink()
            raise ServiceError(f"{target.name} arrived with another content than announced; run the download again")
        partial.replace(target)

    def _json(self, method: str, path: str, **request: Any) -> dict[str, Any]:
        try:
            response = self._http.request(method, path, **request)
        except httpx.ConnectError as error:
            raise ServiceError(
                f"no service answers at {self.url}: start one with 'tomosim serve', or name it with --url",
                code="service-unreachable",
            ) from error
        except httpx.HTTPError as error:
            raise ServiceError(f"{self.url}{path}: {error or type(error).__name__}") from error
        if response.is_error:
            raise self._problem(response)
        return response.json()  # type: ignore[no-any-return]

    def _problem(self, response: httpx.Response) -> ServiceError:
        try:
            problem = response.json()
            text = problem.get("detail") or problem.get("title") or response.reason_phrase
            lines = [f"{e.get('pointer', '')}: {e.get('detail', '')}" for e in problem.get("errors") or []]
        except ValueError:
            problem, text, lines = {}, response.text[:500] or response.reason_phrase, []
        error = ServiceError("; ".join([str(text), *lines]), code=problem.get("code"), problem=problem)
        if response.status_code in (400, 413, 422):
            error.kind = "user"  # type: ignore[misc, assignment]
        return error
