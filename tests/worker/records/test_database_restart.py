"""The database restarts under running cases: they wait and go on, and so does every thread."""

import signal
import sys
import threading
import time

import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from api.app import create_app
from tests.support.waiting import wait_for
from worker.records.database import AWAY, connect, outlast
from worker.records.fleet import Fleet
from worker.records.jobs import Jobs
from worker.serve import broker, processes

CASES = 24
RESTARTS = 10
THREADS = {"reaper", "courier", "garbage", "dicom-indexer"}

LOCAL = {"base_url": "http://127.0.0.1", "client": ("127.0.0.1", 50000), "raise_server_exceptions": False}

pytestmark = pytest.mark.needs_postgresql


@pytest.fixture
def make_service_settings(make_settings, own_postgres):
    def make(**changes):
        fields = {"database_url": own_postgres[1], "broker_url": "", "memory_limit_bytes": 3_000_000_000}
        settings = make_settings(**fields, **changes)
        settings.data_folder.mkdir(parents=True, exist_ok=True)
        return settings

    return make


@pytest.fixture
def children():
    """Processes of the test, killed at its end."""
    started = []
    yield started
    for process in started:
        processes.kill_group(process)


@pytest.fixture
def start(children, tmp_path):
    def start_process(command, settings, name):
        env = processes.environment(settings, TOMOSIM_BROKER_URL=settings.resolved_broker_url)
        with open(tmp_path / f"{name}.log", "wb") as log:
            children.append(processes.start(command, env, log))

    return start_process


class Asker:
    """Asks the API all the time, in a thread of its own; which status codes it answers."""

    def __init__(self, client):
        self.client = client
        self.statuses = set()
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def run(self):
        while not self.stopping.wait(0.02):
            self.statuses.add(self.client.get("/v1/simulations?limit=1").status_code)

    def stop(self):
        self.stopping.set()
        self.thread.join(30.0)
        return self.statuses


@pytest.mark.embedded
def test_ten_restarts_under_running_cases(make_service_settings, own_postgres, start, tmp_path):
    server, url = own_postgres
    settings = make_service_settings(worker_slots=2, sweep_seconds=0.3, resend_seconds=3.0, lease_seconds=10.0)
    start(broker.command(settings), settings, "broker")
    wait_for(lambda: broker.answers(settings))
    for number in range(2):
        start([sys.executable, "-m", "worker"], settings, f"worker{number}")
    engine = connect(url)
    jobs = Jobs(engine)
    with TestClient(create_app(settings), **LOCAL) as client:
        wait_for(lambda: Fleet(engine).alive() == 2)
        for number in range(CASES):
            answer = client.post("/v1/simulations", json={"name": "brief", "seed": number})
            assert answer.status_code == 202, answer.text
        wait_for(lambda: jobs.counts().get("running"))
        asker = Asker(client)
        for number in range(RESTARTS):
            server.stop(signal.SIGQUIT if number % 2 else signal.SIGINT)
            server.start()
            time.sleep(0.7)
        assert asker.stop() == {200, 503}
        wait_for(lambda: not {"queued", "running"} & set(jobs.counts()))
        errors = [(row.id, row.error) for row in jobs.page(100) if row.error]
        assert errors == []
        assert jobs.counts() == {"succeeded": CASES}
        assert {thread.name for thread in threading.enumerate()} >= THREADS
        now = time.time()
        wait_for(lambda: Fleet(engine).alive(time.time() - now) == 2)  # the heartbeats go on
    engine.dispose()


@pytest.mark.parametrize("place", ["_read", "_write", "_flush"])
def test_an_error_of_the_socket_is_one_of_the_database(own_postgres, monkeypatch, place):
    _, url = own_postgres
    engine = connect(url)

    def cut(*args):
        raise BrokenPipeError(32, "Broken pipe")

    with engine.connect() as connection, monkeypatch.context() as patch:
        patch.setattr(f"pg8000.core.{place}", cut)
        with pytest.raises(AWAY, match="network error"):
            connection.execute(sa.text("SELECT 1"))
    with engine.connect() as connection:
        assert connection.scalar(sa.text("SELECT 1")) == 1
        with monkeypatch.context() as patch:
            patch.setattr(f"pg8000.core.{place}", cut)
            with pytest.raises(AWAY, match="network error"):
                connection.commit()
    engine.dispose()


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGQUIT])
def test_a_server_that_stops_within_a_statement(own_postgres, how):
    server, url = own_postgres
    engine = connect(url)
    stopper = threading.Timer(0.5, server.stop, [how])
    stopper.start()
    with pytest.raises(AWAY), engine.begin() as connection:
        connection.execute(sa.text("SELECT pg_sleep(20)"))
    stopper.join()
    engine.dispose()


def test_a_server_that_takes_no_connections_yet(own_postgres):
    server, url = own_postgres
    engine, other = connect(url), connect(url)
    with engine.connect() as connection:
        connection.execute(sa.text("SELECT 1"))
        server.process.send_signal(signal.SIGTERM)  # it ends when this session does

        def refused():
            with pytest.raises(AWAY) as error:
                other.connect()
            return "57P03" in str(error.value)

        wait_for(refused)
    engine.dispose()
    other.dispose()


def test_a_claim_whose_answer_was_lost_is_made_again(make_service_settings, own_postgres, monkeypatch):
    _, url = own_postgres
    engine = connect(url)
    jobs = Jobs(engine)
    identifier = jobs.create({}, {}).id
    commit = engine.dialect.do_commit

    def lose_the_answer(connection):
        commit(connection)
        monkeypatch.setattr(engine.dialect, "do_commit", commit)
        raise engine.dialect.loaded_dbapi.OperationalError("network error")

    monkeypatch.setattr(engine.dialect, "do_commit", lose_the_answer)
    row = outlast(lambda: jobs.claim(identifier, "a"), lambda: False)
    assert row is not None
    assert (row.owner, row.attempt) == ("a", 1)
    assert jobs.claim(identifier, "b") is None
    engine.dispose()


def test_the_api_says_503_while_the_database_is_away(make_service_settings, own_postgres, is_unavailable):
    server, _ = own_postgres
    app = create_app(make_service_settings(), sweep=False)
    with TestClient(app, **LOCAL) as client:
        for how in (signal.SIGINT, signal.SIGQUIT):
            assert client.get("/v1/simulations").status_code == 200
            server.stop(how)
            for _ in range(3):
                is_unavailable(client.get("/v1/simulations"))
                is_unavailable(client.post("/v1/simulations", json={}, headers={"Idempotency-Key": "once"}))
            server.start()
            assert client.get("/v1/simulations").status_code == 200


@pytest.fixture
def is_unavailable():
    def check(response):
        assert response.status_code == 503, response.text
        assert response.json()["code"] == "database-unavailable"
        assert int(response.headers["retry-after"]) > 0

    return check
