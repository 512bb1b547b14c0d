"""One computation of a stage however many cases, workers and machines ask for it."""

import os
import signal
import sys
from collections import Counter

import pytest
from fastapi.testclient import TestClient

from api.app import create_app
from tests.support.servers import processes
from tests.support.waiting import wait_for
from worker.records.database import connect
from worker.records.fleet import Fleet
from worker.serve import broker
from worker.serve.processes import environment

pytestmark = pytest.mark.sweep  # whole cases through two workers


@pytest.fixture
def start():
    with processes() as run:
        yield run


@pytest.fixture(params=["folder", "bucket"])
def machines(request, make_settings, tmp_path):
    """Settings of two workers: of one machine, with one folder; of two, each with its own and one bucket."""
    if request.param == "folder":
        settings = make_settings()
        return [settings, settings]
    location = request.getfixturevalue("make_location")()
    bucket = {
        "store_url": location.url,
        "store_endpoint": location.endpoint,
        "store_access_key": location.access_key,
        "store_secret_key": location.secret_key,
    }
    return [make_settings(data_folder=tmp_path / name, **bucket) for name in ("one", "two")]


@pytest.fixture
def log(tmp_path, monkeypatch):
    """What was computed, by whom: (stage, seed, process, begun or done)."""
    path = tmp_path / "computed"
    path.touch()
    monkeypatch.setenv("SHARED_PIPELINE_LOG", str(path))
    return lambda: [tuple(line.split()) for line in path.read_text().splitlines()]


@pytest.fixture
def client(machines, start, free_port, tmp_path, log):
    """The API, and two workers that are ready."""
    command = [str(broker.find_server()), "--port", str(free_port), "--bind", "127.0.0.1"]
    start([*command, "--dir", str(tmp_path), "--save", ""])
    shared = {
        "database_url": f"sqlite:///{tmp_path / 'shared.db'}",
        "broker_url": f"redis://127.0.0.1:{free_port}/0",
        "pipeline": "tests.support.shared_pipeline:run",
        "sweep_seconds": 0.2,
    }
    workers = [settings.model_copy(update=shared) for settings in machines]
    with TestClient(create_app(workers[0]), base_url="http://127.0.0.1", client=("127.0.0.1", 50000)) as http:
        for settings in workers:
            start([sys.executable, "-m", "worker"], environment(settings))
        engine = connect(shared["database_url"])
        wait_for(lambda: Fleet(engine).alive() == 2, "the start of two workers")
        engine.dispose()
        yield http


def post(client, seeds, views):
    axes = [
        {"kind": "grid", "field": "seed", "values": seeds},
        {"kind": "grid", "field": "acquisition.views", "values": views},
    ]
    response = client.post("/v1/studies", json={"axes": axes})
    assert response.status_code == 202, response.text
    return response.json()["links"]


def ended(client, links):
    study = wait_for(lambda: (s := client.get(links["self"]).json())["finished_at"] and s, "the end of the study")
    assert study["state"] == "succeeded", client.get(links["cases"]).text
    return study


def test_workers_share_the_stages_of_a_study(client, log):
    ended(client, post(client, [1, 2], [3, 5, 7, 9]))
    done = Counter((stage, seed) for stage, seed, _, what in log() if what == "done")
    assert done == {(stage, seed): 1 for stage in ("phantom", "mesh", "fem") for seed in "12"} | {
        ("projection", seed): 4 for seed in "12"
    }
    assert Counter(what for *_, what in log())["begun"] == sum(done.values())
    assert len({process for _, _, process, _ in log()}) == 2


def test_a_killed_holder_holds_up_nobody(client, log):
    """Both workers want one phantom; the one that computes it is killed; the other goes on."""
    links = post(client, [1], [3, 5])

    def both():
        return client.get(links["self"]).json()["counts"]["running"] == 2 and log()

    (_, _, process, what), *others = wait_for(both, "both cases")
    assert (what, others) == ("begun", [])
    os.kill(int(process), signal.SIGKILL)
    ended(client, links)
    phantoms = [(p, what) for stage, _, p, what in log() if stage == "phantom"]
    assert Counter(what for _, what in phantoms) == {"begun": 2, "done": 1}
    assert phantoms[0] == (process, "begun")
    assert phantoms[1][0] != process
