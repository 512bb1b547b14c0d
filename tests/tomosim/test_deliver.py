"""The whole house with the real pipeline: a case is simulated, sent to Orthanc with its success, and read back."""

import os
import signal
import sys
from io import BytesIO

import httpx
import pytest
from pydicom import dcmread

from simcore import presets
from tests.support.orthanc import running
from tests.support.ports import free_port
from tests.support.servers import answers, program
from tests.support.waiting import wait_for
from tomosim.cli import main

PATIENCE_SECONDS = 400
START_SECONDS = PATIENCE_SECONDS


@pytest.fixture(scope="module")
def service(tmp_path_factory, module_backend):
    folder = tmp_path_factory.mktemp("data")
    port = free_port()
    command = [sys.executable, "-m", "tomosim", "serve", "--data", str(folder), "--port", str(port)]
    env = {**os.environ, **{f"TOMOSIM_{name.upper()}": str(value) for name, value in module_backend.items()}}
    url = f"http://127.0.0.1:{port}"
    log = tmp_path_factory.mktemp("log") / "log"
    with program(command, lambda: answers(f"{url}/readyz"), log, env, START_SECONDS) as process:
        yield url
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


@pytest.fixture(scope="module")
def orthanc(tmp_path_factory):
    """(DICOM port, address) of a running Orthanc."""
    # Label maps are younger than this Orthanc.
    options = {"DicomAet": "ARCHIVE", "UnknownSopClassAccepted": True}
    with running(tmp_path_factory.mktemp("orthanc"), plugin=False, **options) as archive:
        yield archive.port, archive.url


@pytest.mark.needs_orthanc
def test_a_case_goes_to_an_archive_with_its_success(service, orthanc, capsys):
    port, archive = orthanc
    assert main(["destination", "add", "archive", "127.0.0.1", str(port), "ARCHIVE", "--url", service]) == 0
    assert main(["destination", "echo", "archive", "--url", service]) == 0
    assert "it accepts" in capsys.readouterr().out
    specification = presets.get("tiny").model_dump(mode="json")
    body = {**specification, "deliver": [{"destination": "archive"}]}
    case = httpx.post(f"{service}/v1/simulations", json=body).json()
    listing = f"{service}/v1/deliveries?simulation_id={case['id']}"
    delivery = wait_for(lambda: httpx.get(listing).json()["items"], "the delivery")[0]
    path = f"{service}{delivery['links']['self']}"
    ended = wait_for(lambda: (d := httpx.get(path).json())["state"] not in ("queued", "running") and d, "its end")
    assert (ended["state"], ended["error"]) == ("succeeded", None)
    files = {a["name"]: a for a in httpx.get(f"{service}{case['links']['self']}/artifacts").json()["items"]}
    dicom = [name for name in files if name.endswith(".dcm")]
    assert sorted(i["name"] for i in ended["instances"]) == sorted(dicom)
    instances = {}
    for identifier in httpx.get(f"{archive}/instances").json():
        stored = dcmread(BytesIO(httpx.get(f"{archive}/instances/{identifier}/file").content))
        instances[str(stored.SOPInstanceUID)] = stored
    for instance in ended["instances"]:
        ours = dcmread(BytesIO(httpx.get(f"{service}{files[instance['name']]['href']}").content))
        theirs = instances.pop(instance["sop_instance_uid"])
        assert theirs == ours
    assert instances == {}


def test_what_is_wrong_is_said(service, capsys):
    assert main(["destination", "add", "closed", "127.0.0.1", "1", "NOBODY", "--url", service]) == 0
    assert main(["destination", "add", "closed", "127.0.0.1", "1", "NOBODY", "--url", service]) != 0
    assert "another destination has this name" in capsys.readouterr().err
    assert main(["destination", "add", "bad", "127.0.0.1", "1", "A" * 17, "--url", service]) == 2
    assert "called_aet" in capsys.readouterr().err
    assert main(["destination", "echo", "closed", "--url", service]) == 4
    assert "nothing listens at 127.0.0.1:1" in capsys.readouterr().err
    assert main(["destination", "list", "--url", service]) == 0
    assert "NOBODY@127.0.0.1:1" in capsys.readouterr().out
    assert main(["deliver", "0" * 32, "closed", "--url", service]) != 0
    assert "no simulation" in capsys.readouterr().err
    assert main(["destination", "remove", "nowhere", "--url", service]) == 2
    assert "closed" in capsys.readouterr().err
    assert main(["destination", "remove", "closed", "--url", service]) == 0
    assert main(["destination", "list", "--url", service]) == 0
    assert "closed" not in capsys.readouterr().out
