"""Request identifiers and priorities: from the header to the row, to the logs and to the queue."""

import logging

import pytest
from fastapi.testclient import TestClient

from api.app import create_app
from worker.records.jobs import Jobs


@pytest.mark.parametrize("identifier", ["abc", "4bf92f3577b34da6a3ce929d0e0e4736", "job:7/case=3@portal"])
def test_a_sane_identifier_is_kept(client, identifier):
    assert client.get("/livez", headers={"X-Request-Id": identifier}).headers["x-request-id"] == identifier


@pytest.mark.parametrize("identifier", ["", "a b", "x" * 129, 'a"b', "-a", "é".encode()])
def test_any_other_is_replaced(client, identifier):
    new = client.get("/livez", headers={"X-Request-Id": identifier}).headers["x-request-id"]
    assert len(new) == 32
    assert new != client.get("/livez").headers["x-request-id"]


def test_it_is_in_problems_and_in_the_row(client, served, is_problem):
    header = {"X-Request-Id": "mine"}
    assert is_problem(client.get("/v1/none", headers=header), 404, "not-found")["request_id"] == "mine"
    case = client.post("/v1/simulations", json={}, headers=header).json()
    assert (case["request_id"], case["submitted_by"]) == ("mine", "local")
    assert served.jobs.get(case["id"]).request_id == "mine"


def test_refusals_before_any_route_have_one(client, is_problem):
    refused = client.post("/v1/simulations", headers={"Origin": "https://attacker.example", "X-Request-Id": "mine"})
    assert is_problem(refused, 403, "cross-origin")["request_id"] == "mine"
    assert refused.headers["x-request-id"] == "mine"


def test_a_mistake_of_ours_is_found_by_it(settings, broker, is_problem, monkeypatch, caplog):
    def broken(*_):
        raise RuntimeError("password")

    monkeypatch.setattr(Jobs, "page", broken)
    app = create_app(settings, broker, sweep=False)
    with (
        TestClient(app, base_url="http://127.0.0.1", client=("127.0.0.1", 1), raise_server_exceptions=False) as client,
        caplog.at_level(logging.INFO, "api.http.requests"),
    ):
        refused = client.get("/v1/simulations", headers={"X-Request-Id": "mine"})
    problem = is_problem(refused, 500, "internal-error")
    assert problem["request_id"] == refused.headers["x-request-id"] == "mine"
    failed, line = caplog.records
    assert (failed.message, failed.exc_info[0]) == ("request failed", RuntimeError)
    assert (line.status, line.key) == (500, "local")


def test_what_changes_something_is_logged(client, caplog):
    with caplog.at_level(logging.INFO, "api.http.requests"):
        client.get("/v1/simulations")
        client.post("/v1/simulations", json={})
    [line] = caplog.records
    assert (line.method, line.path, line.status, line.key) == ("POST", "/v1/simulations", 202, "local")


def test_priorities(client, broker, is_problem):
    case = client.post("/v1/simulations?priority=batch", json={}).json()
    assert case["queue"] == "batch"
    assert "priority" not in case["specification"]
    assert broker.messages == [(case["id"], "batch")]
    assert client.post("/v1/simulations", json={}).json()["queue"] == "interactive"
    problem = is_problem(client.post("/v1/simulations?priority=high", json={}), 422, "invalid-request")
    assert problem["errors"][0]["parameter"] == "priority"
    assert "'batch'" in problem["errors"][0]["detail"]


def test_a_gpu_is_asked_for_where_there_is_one(client, settings, broker, is_problem):
    problem = is_problem(client.post("/v1/simulations?device=gpu", json={}), 422, "invalid-request")
    assert problem["errors"][0] == {"parameter": "device", "value": "gpu", "detail": "allowed here: cpu"}
    with_gpu = settings.model_copy(update={"gpu": True})
    app = create_app(with_gpu, broker, sweep=False)
    with TestClient(app, base_url="http://127.0.0.1", client=("127.0.0.1", 1)) as other:
        assert other.post("/v1/simulations?device=gpu", json={}).json()["queue"] == "gpu.interactive"
        assert other.post("/v1/simulations?device=gpu&priority=batch", json={}).json()["queue"] == "gpu.batch"
