"""``python -m api`` and ``python -m worker`` as docker-compose starts them: PostgreSQL, a broker on TCP."""

import subprocess
import sys

import httpx
import pytest

from tests.support.ports import free_ports
from tests.support.servers import answers, processes
from tests.support.services import need
from tests.support.waiting import wait_for
from worker.serve import broker
from worker.serve.processes import environment


@pytest.fixture
def start():
    with processes() as run:
        yield run


@pytest.fixture(params=["embedded", pytest.param("redis-server", marks=pytest.mark.needs_redis)])
def broker_program(request):
    """The broker of the package, and the one that a distribution brings."""
    if request.param == "embedded":
        return str(broker.find_server())
    return need("redis-server", "redis-server")


@pytest.mark.needs_postgresql
def test_separate_processes(start, make_settings, postgres_url, empty_postgres, broker_program, tmp_path):
    empty_postgres()
    port, broker_port = free_ports(2)
    command = [broker_program, "--port", str(broker_port), "--bind", "127.0.0.1", "--dir", str(tmp_path)]
    start([*command, "--save", ""])
    settings = make_settings(
        database_url=postgres_url, broker_url=f"redis://127.0.0.1:{broker_port}/0", port=port, sweep_seconds=0.3
    )
    env = environment(settings)
    subprocess.run([sys.executable, "-m", "tomosim", "db", "upgrade"], env=env, check=True)
    worker = start([sys.executable, "-m", "worker"], env)
    start([sys.executable, "-m", "api"], env)
    url = f"http://127.0.0.1:{port}"
    wait_for(lambda: answers(f"{url}/readyz"), "readiness")
    assert subprocess.run([sys.executable, "-m", "worker.health"], env=env).returncode == 0

    case = url + httpx.post(f"{url}/v1/simulations", json={"name": "fine"}).json()["links"]["self"]
    wait_for(lambda: httpx.get(case).json()["state"] == "succeeded", "the end of the case")
    assert len(httpx.get(f"{case}/artifacts").json()["items"]) == 3

    if broker_program == str(broker.find_server()):
        return  # what follows is between workers and the database, and takes as long again

    # A worker that is stopped says so, and gives its case to the next one.
    slow = url + httpx.post(f"{url}/v1/simulations", json={"name": "slow"}).json()["links"]["self"]
    wait_for(lambda: httpx.get(slow).json()["progress"]["message"].startswith("step"), "the computation")
    worker.terminate()
    worker.wait(60)
    assert httpx.get(slow).json()["state"] == "queued"
    assert subprocess.run([sys.executable, "-m", "worker.health"], env=env, stderr=subprocess.DEVNULL).returncode == 1
    start([sys.executable, "-m", "worker"], env)
    wait_for(lambda: httpx.get(slow).json()["state"] == "succeeded", "the end of the case")
