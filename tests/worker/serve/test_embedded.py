"""The whole service in one process tree: start, work, kill this and that, stop, go on."""

import hashlib
import os
import signal
import socket
import subprocess
import sys
import zipfile
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from tests.support.waiting import wait_for
from worker.serve import broker
from worker.serve.processes import environment
from worker.settings import Settings

PATIENCE_SECONDS = 90


def stat(pid):
    """(state, parent) of a process; None where there is none."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return None
    return fields[0], int(fields[1])


def is_alive(pid):
    state = stat(pid)
    return state is not None and state[0] not in "ZX"


def tree(pid):
    """{pid: command line} of a process and all below it."""
    parents = {int(p.name): s[1] for p in Path("/proc").iterdir() if p.name.isdigit() and (s := stat(p.name))}
    pids, new = set(), {pid}
    while new:
        pids |= new
        new = {child for child, parent in parents.items() if parent in new} - pids
    return {p: Path(f"/proc/{p}/cmdline").read_bytes().replace(b"\0", b" ").decode() for p in pids if is_alive(p)}


class Service:
    """``python -m worker.serve.embedded`` in a process of its own."""

    def __init__(self, settings: Settings, log: Path) -> None:
        self.settings = settings
        self.url = f"http://127.0.0.1:{settings.port}"
        self.log = log
        with open(log, "wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "worker.serve.embedded"],
                env=environment(settings),
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        self.http = httpx.Client(base_url=self.url, timeout=30)

    def wait_until_ready(self):
        def ready():
            assert self.process.poll() is None, self.log.read_text()
            return "tomosim is ready" in self.log.read_text()

        wait_for(ready, "the start")
        return self

    def post(self, **specification):
        response = self.http.post("/v1/simulations", json=specification)
        assert response.status_code == 202, response.text
        return response.json()["links"]["self"]

    def get(self, path):
        return self.http.get(path).json()

    def wait(self, path, *states):
        return wait_for(lambda: (case := self.get(path))["state"] in states and case, f"one of {states}")

    def computing(self, path):
        """Waits until the last stage of a case is under way."""
        return wait_for(lambda: (self.get(path)["progress"]["message"] or "").startswith("step"), "the computation")

    def pid_of(self, words):
        pids = [p for p, command in tree(self.process.pid).items() if words in command]
        assert len(pids) == 1, f"{words}: {tree(self.process.pid)}"
        return pids[0]

    def stop(self, number=signal.SIGTERM):
        pids = list(tree(self.process.pid))
        self.process.send_signal(number)
        code = self.process.wait(PATIENCE_SECONDS)
        assert [p for p in pids if is_alive(p)] == []
        return code


@pytest.fixture
def start(make_settings, free_port, tmp_path):
    """Starts services on one data folder; what still runs in the end is killed."""
    started = []

    @contextmanager
    def make(**changes):
        settings = make_settings(port=free_port, sweep_seconds=0.3, **changes)
        service = Service(settings, tmp_path / f"out{len(started)}")
        started.append(service)
        yield service

    yield make
    for service in started:
        service.http.close()
        if service.process.poll() is None:
            pids = list(tree(service.process.pid))
            service.process.kill()
            service.process.wait()
            wait_for(lambda pids=pids: not any(map(is_alive, pids)), "the end")


def test_from_start_to_stop(start, make_settings, free_port, tmp_path):
    with start() as service:
        service.wait_until_ready()
        assert service.url in service.log.read_text()

        # One case over HTTP, to files with the announced content.
        path = service.post(name="fine", seed=4)
        with service.http.stream("GET", f"{path}/events") as stream:
            kinds = [line for line in stream.iter_lines() if line.startswith("event: ")]
        assert kinds[0] == "event: state"
        assert "event: progress" in kinds
        assert service.get(path)["state"] == "succeeded"
        for item in service.get(f"{path}/artifacts")["items"]:
            assert hashlib.sha256(service.http.get(item["href"]).content).hexdigest() == item["sha256"]
        (tmp_path / "case.zip").write_bytes(service.http.get(f"{path}/archive").content)
        assert zipfile.ZipFile(tmp_path / "case.zip").testzip() is None

        # A second instance on the same folder is refused and harms nothing.
        second = subprocess.run(
            [sys.executable, "-m", "worker.serve.embedded"],
            env=environment(make_settings(port=free_port)),
            capture_output=True,
            text=True,
            timeout=PATIENCE_SECONDS,
        )
        assert second.returncode == 1
        assert str(service.settings.data_folder) in second.stderr
        assert str(service.process.pid) in second.stderr

        # Cancelled while it runs; a crash; neither keeps the next one from running.
        running = service.post(name="forever", seed=5)
        service.computing(running)
        compute = service.pid_of("worker.compute")
        assert service.http.post(f"{running}/cancel").status_code == 202
        service.wait(running, "cancelled")
        assert not is_alive(compute)
        crashed = service.post(name="crash")
        assert service.wait(crashed, "failed")["error"]["code"] == "compute-crashed"
        assert service.wait(service.post(name="next"), "succeeded")

        # Ctrl-C while one runs and one waits: nothing is left running, nothing is lost.
        running = service.post(name="slower", seed=6)  # not over before the signal comes, however busy the machine
        waiting = service.post(name="waiting", seed=7)
        service.computing(running)
        assert service.stop(signal.SIGINT) == 0

    with start() as service:
        service.wait_until_ready()
        first = service.wait(running, "succeeded")
        assert first["attempt"] == 1
        assert service.get(f"{running}/manifest")["computed_stages"] == 1  # the first stage was kept
        service.wait(waiting, "succeeded")
        assert service.stop() == 0


def test_everything_that_can_be_killed(start, backend):
    # A database of its own has no other worker whose lease would have to run out first.
    with start(**({"lease_seconds": 5} if backend else {})) as service:
        service.wait_until_ready()
        path = service.post(name="slow", seed=8)
        service.computing(path)
        # The worker: its case is taken up again by the next one.
        os.kill(service.pid_of("-m worker "), signal.SIGKILL)
        wait_for(lambda: service.get(path)["attempt"] == 2, "the second attempt")
        # The broker: cases that are posted meanwhile are sent when it is back.
        if not backend:
            server = "valkey-server" if "valkey" in broker.find_server().name else "redis"
            os.kill(service.pid_of(server), signal.SIGKILL)
        meanwhile = service.post(name="meanwhile")
        service.wait(path, "succeeded")
        service.wait(meanwhile, "succeeded")
        # The whole tree at its root: nothing is left, and the next start goes on at once.
        path = service.post(name="slow", seed=9)
        service.computing(path)
        pids = list(tree(service.process.pid))
        service.process.kill()
        service.process.wait()
        wait_for(lambda: not any(map(is_alive, pids)), "the end of all children")

    with start(lease_seconds=5 if backend else 3600) as service:
        service.wait_until_ready()
        assert service.wait(path, "succeeded")["attempt"] == 2
        assert service.stop() == 0


def test_a_port_in_use_is_named(start, free_port):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", free_port))
        taken.listen()
        with start() as service:
            assert service.process.wait(PATIENCE_SECONDS) == 1
            assert f"port {free_port}" in service.log.read_text()
            assert "TOMOSIM_PORT" in service.log.read_text()


def test_without_a_broker_it_is_never_ready(start, tmp_path):
    with start(database_url=f"sqlite:///{tmp_path}/a.db", broker_url="redis://127.0.0.1:1/0") as service:
        # The worker waits for its broker; the service is never ready, and says so when it is stopped.
        wait_for(lambda: len(tree(service.process.pid)) > 1, "a child")
        assert service.stop() == 0
        assert "ready" not in service.log.read_text()


def test_a_folder_that_cannot_be_used(start, tmp_path):
    (tmp_path / "file").write_text("")
    with start(data_folder=tmp_path / "file") as service:
        assert service.process.wait(PATIENCE_SECONDS) == 1
        assert f"{tmp_path / 'file'} cannot be used" in service.log.read_text()
