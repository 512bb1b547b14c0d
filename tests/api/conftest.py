"""The API in this process, with a fake broker; cases are ended by hand or by the fake pipeline."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from starlette.routing import BaseRoute

from api.app import create_app
from api.http.deps import Services
from simcore.spec import SimulationSpec
from tests.support import fake_pipeline
from tests.support.brokers import MemoryBroker
from worker.settings import Settings

URL = "http://127.0.0.1"
LOOPBACK = ("127.0.0.1", 50000)


@pytest.fixture
def broker() -> MemoryBroker:
    return MemoryBroker()


@pytest.fixture
def settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, backend: dict[str, object], sqlite_template: Path
) -> Settings:
    for name in [n for n in os.environ if n.startswith("TOMOSIM_")]:
        monkeypatch.delenv(name)
    folder = tmp_path / "data"
    folder.mkdir()
    if not backend:
        shutil.copyfile(sqlite_template, folder / "tomosim.db")
    return Settings.load(data_folder=folder, memory_limit_bytes=8_000_000_000, **backend)


@pytest.fixture(scope="session")
def routes(tmp_path_factory: pytest.TempPathFactory) -> list[BaseRoute]:
    """Those of an application. FastAPI works them out at the first request, which takes it 0.2 s."""
    settings = Settings(data_folder=tmp_path_factory.mktemp("routes"))
    return create_app(settings, MemoryBroker(), sweep=False).router.routes


@pytest.fixture
def client(settings: Settings, broker: MemoryBroker, routes: list[BaseRoute]) -> Iterator[TestClient]:
    app = create_app(settings, broker, sweep=False)
    app.router.routes[:] = routes
    with TestClient(app, base_url=URL, client=LOOPBACK) as made:
        yield made


@pytest.fixture
def served(client: TestClient) -> Services:
    return client.app.state.services


@pytest.fixture
def post(client: TestClient) -> Callable[..., dict]:
    """Posts a specification and returns the resource."""

    def make(**specification: object) -> dict:
        response = client.post("/v1/simulations", json=specification)
        assert response.status_code == 202, response.text
        return response.json()

    return make


@pytest.fixture
def finish(served: Services) -> Callable[[str], None]:
    """Runs a queued case with the fake pipeline, here."""

    def run(identifier: str) -> None:
        assert served.jobs.claim(identifier, "test")
        specification = SimulationSpec.from_dict(served.jobs.specification(identifier))
        result = fake_pipeline.run(specification, served.store, lambda *a, **k: None)
        assert served.jobs.succeed(identifier, "test", result.manifest)

    return run


@pytest.fixture
def done(post: Callable[..., dict], finish: Callable[[str], None]) -> str:
    """The path of a case that succeeded."""
    case = post(name="fine", seed=3)
    finish(case["id"])
    return case["links"]["self"]


def is_problem(response, status: int, code: str) -> dict:
    """Asserts that an answer is a problem document; returns it."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    body = response.json()
    assert body["code"] == code
    assert body["status"] == status
    assert {"type", "title", "detail"} <= set(body)
    assert body["instance"] == response.request.url.path
    return body


@pytest.fixture(name="is_problem")
def is_problem_fixture() -> Callable[..., dict]:
    return is_problem
