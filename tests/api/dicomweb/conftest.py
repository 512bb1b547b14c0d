"""The real application on a loopback port, with a small case that the real export has written."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pydicom
import pytest
from dicomweb_client import DICOMwebClient
from fastapi.testclient import TestClient

from api.app import create_app
from api.http.deps import Services
from simcore.store.hashing import FileRef
from tests.support import dicom_case
from tests.support.brokers import SilentBroker
from tests.support.servers import served as served_app
from worker.settings import Settings


@dataclass
class Case:
    """A case of the service and its DICOM files as pydicom reads them from the export's own folder."""

    id: str
    datasets: dict[str, pydicom.Dataset] = field(default_factory=dict)
    paths: dict[str, Path] = field(default_factory=dict)

    @property
    def study(self) -> str:
        return str(self.datasets["tomosynthesis.dcm"].StudyInstanceUID)

    def uids(self, name: str) -> tuple[str, str, str]:
        """Study, series and instance of a file."""
        d = self.datasets[name]
        return str(d.StudyInstanceUID), str(d.SeriesInstanceUID), str(d.SOPInstanceUID)

    def url(self, name: str) -> str:
        """Path of the instance of a file."""
        study, series, instance = self.uids(name)
        return f"/dicomweb/studies/{study}/series/{series}/instances/{instance}"


@pytest.fixture(scope="session")
def make_case() -> Callable[..., object]:
    """Arguments of an export, made by hand."""
    return dicom_case.make_case


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory, make_case: Callable[..., object]) -> Callable[..., Path]:
    """A folder with the files of a case; made once for the same arguments."""
    made: dict[str, Path] = {}

    def export(**arguments: object) -> Path:
        key = repr(sorted(arguments.items()))
        if key not in made:
            made[key] = tmp_path_factory.mktemp("exported")
            make_case(**arguments).export(made[key])
        return made[key]

    return export


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory, module_backend: dict[str, object]) -> Settings:
    with pytest.MonkeyPatch.context() as patch:
        for name in Settings.model_fields:
            patch.delenv(f"TOMOSIM_{name.upper()}", raising=False)
        folder = tmp_path_factory.mktemp("data")
        return Settings.load(data_folder=folder, memory_limit_bytes=8_000_000_000, **module_backend)


@pytest.fixture(scope="module")
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(
        create_app(settings, SilentBroker(), sweep=False), base_url="http://127.0.0.1", client=("127.0.0.1", 50000)
    ) as made:
        yield made


@pytest.fixture(scope="module")
def served(client: TestClient) -> Services:
    return client.app.state.services


@pytest.fixture(scope="module")
def add_case(client: TestClient, served: Services, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Case]:
    """Makes a case that succeeded, with the files of a folder."""

    def add(folder: Path, name: str = "") -> Case:
        posted = client.post("/v1/simulations", json={"name": name})
        assert posted.status_code == 202, posted.text
        case = Case(posted.json()["id"])
        assert served.jobs.claim(case.id, "test")
        files: dict[str, FileRef] = {}
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            file_name = path.relative_to(folder).as_posix()
            copy = tmp_path_factory.mktemp("copy") / path.name
            copy.write_bytes(path.read_bytes())
            files[file_name] = served.store.add(copy)
            if path.suffix == ".dcm":
                case.datasets[file_name] = pydicom.dcmread(path)
                case.paths[file_name] = path
        manifest = {"files": {n: asdict(ref) for n, ref in files.items()}, "stages": [], "results": {}}
        assert served.jobs.succeed(case.id, "test", manifest)
        return case

    return add


@pytest.fixture(scope="module")
def case(add_case: Callable[..., Case], exported: Callable[..., Path]) -> Case:
    return add_case(exported(), "small")


@pytest.fixture(scope="module", params=["none", "jpeg-ls"])
def full_case(request: pytest.FixtureRequest, add_case: Callable[..., Case], exported: Callable[..., Path]) -> Case:
    """Every kind of object; labels are RLE in both."""
    extras = ["presentation", "synthetic-2d", "ct", "attenuation", "report"]
    return add_case(exported(seed=2, lesions=True, extras=extras, encoding=request.param), f"full {request.param}")


@pytest.fixture(scope="module")
def address(client: TestClient) -> Iterator[str]:
    """The same application on a free loopback port."""
    with served_app(client.app, lifespan="off") as url:
        yield url


@pytest.fixture(scope="module")
def web(address: str) -> DICOMwebClient:
    return DICOMwebClient(f"{address}/dicomweb")


@pytest.fixture(name="is_problem")
def is_problem_fixture() -> Callable[..., dict]:
    def check(response, status: int, code: str) -> dict:
        assert response.status_code == status, response.text
        assert response.headers["content-type"] == "application/problem+json"
        body = response.json()
        assert (body["code"], body["status"]) == (code, status)
        return body

    return check
