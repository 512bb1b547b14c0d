"""Orthanc, an archive of DICOM files, on free loopback ports."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from tests.support.ports import free_ports, listens
from tests.support.servers import program
from tests.support.services import need, need_file

PLUGIN = Path("/usr/share/orthanc/plugins/libOrthancDicomWeb.so")


class Orthanc:
    """A running Orthanc: its DICOM port, its address, and its REST interface."""

    def __init__(self, port: int, url: str) -> None:
        self.port = port
        self.url = url
        # A connection that was kept may be closed by Orthanc just as it is used again.
        limits = httpx.Limits(max_keepalive_connections=0)
        self.http = httpx.Client(base_url=url, timeout=60, headers={"Accept-Encoding": "identity"}, limits=limits)

    def answers(self) -> bool:
        try:
            return self.http.get("/system").is_success
        except httpx.HTTPError:
            return False

    def instances(self) -> list[str]:
        answer: list[str] = self.http.get("/instances").json()
        return answer

    def uids(self) -> list[str]:
        return sorted(
            self.http.get(f"/instances/{i}/simplified-tags").json()["SOPInstanceUID"] for i in self.instances()
        )


@contextmanager
def running(folder: Path, plugin: bool = True, **options: Any) -> Iterator[Orthanc]:
    """Orthanc, called PEER, which takes everything.

    plugin: with DICOMweb
    options: of its configuration file
    raises: Missing where a package is not installed
    """
    command = need("Orthanc", "orthanc")
    plugins = [str(need_file(PLUGIN, "orthanc-dicomweb"))] if plugin else []
    port, http = free_ports(2)
    configuration = {
        "StorageDirectory": str(folder / "db"),
        "IndexDirectory": str(folder / "db"),
        "DicomAet": "PEER",
        "DicomPort": port,
        "HttpPort": http,
        "RemoteAccessAllowed": False,
        "AuthenticationEnabled": False,
        "DicomCheckCalledAet": True,
        "DicomAlwaysAllowStore": True,
        "Plugins": plugins,
        **options,
    }
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "orthanc.json").write_text(json.dumps(configuration))
    archive = Orthanc(port, f"http://127.0.0.1:{http}")

    def ready() -> bool:
        return archive.answers() and (not configuration.get("DicomServerEnabled", True) or listens(port))

    with program([command, str(folder / "orthanc.json")], ready, folder / "log", cwd=folder):
        try:
            yield archive
        finally:
            archive.http.close()
