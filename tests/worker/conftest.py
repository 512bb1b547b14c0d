"""What tests of the service start with: settings on a fresh folder, a database, the fake pipeline."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import sqlalchemy as sa

from worker.records.database import connect
from worker.records.jobs import Jobs
from worker.settings import Settings


class Clock:
    """Seconds that pass only when told."""

    def __init__(self) -> None:
        self.now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.needs_postgresql)])
def engine(request: pytest.FixtureRequest, tmp_path: Path, sqlite_template: Path) -> Iterator[sa.Engine]:
    """A database with all tables and no row."""
    if request.param == "sqlite":
        shutil.copyfile(sqlite_template, tmp_path / "tomosim.db")
        made = connect(f"sqlite:///{tmp_path / 'tomosim.db'}")
    else:
        made = connect(request.getfixturevalue("empty_service_database"))
    yield made
    made.dispose()


@pytest.fixture
def jobs(engine: sa.Engine, clock: Clock) -> Jobs:
    return Jobs(engine, lease_seconds=30, clock=clock)


def _settings(folder: Path, patch: pytest.MonkeyPatch, backend: dict[str, object]) -> Callable[..., Settings]:
    for name in [n for n in os.environ if n.startswith("TOMOSIM_")]:
        patch.delenv(name)

    def make(**changes: object) -> Settings:
        given = {
            "data_folder": folder,
            "pipeline": "tests.support.fake_pipeline:run",
            "memory_limit_bytes": 3_000_000_000,
        }
        return Settings.load(**{**given, **backend, **changes})

    return make


@pytest.fixture
def make_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, backend: dict[str, object]
) -> Callable[..., Settings]:
    """Settings on a fresh data folder, with the fake pipeline."""
    return _settings(tmp_path / "data", monkeypatch, backend)


@pytest.fixture(scope="module")
def make_module_settings(
    tmp_path_factory: pytest.TempPathFactory, module_backend: dict[str, object]
) -> Iterator[Callable[..., Settings]]:
    """The same on a data folder, and with services, that the tests of a module share."""
    with pytest.MonkeyPatch.context() as patch:
        yield _settings(tmp_path_factory.mktemp("data"), patch, module_backend)
