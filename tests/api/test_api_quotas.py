"""Quotas of API keys: 429 with Retry-After, also when many ask at once."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from fastapi.testclient import TestClient

from api.app import create_app

URL, LOOPBACK = "http://127.0.0.1", ("127.0.0.1", 50000)


@pytest.fixture
def post_with(client, served):
    """Posts a case with a new key that has these quotas."""

    def make(**quotas):
        secret = served.keys.create("portal", ["read", "write"], **quotas)[1]
        return lambda: client.post("/v1/simulations", json={}, headers={"Authorization": f"Bearer {secret}"})

    return make


def test_active_cases(client, served, finish, post_with, is_problem):
    post = post_with(active_cases=2)
    first = post().json()["id"]
    assert post().status_code == 202
    refused = post()
    assert "2 cases queued or running" in is_problem(refused, 429, "quota")["detail"]
    assert int(refused.headers["retry-after"]) > 0
    finish(first)
    assert post().status_code == 202
    # Another key has its own.
    assert post_with(active_cases=1)().status_code == 202


def test_cases_per_day(served, finish, post_with, is_problem, monkeypatch):
    now = served.jobs.clock()
    monkeypatch.setattr(served.jobs, "clock", lambda: now)
    post = post_with(cases_per_day=1)
    finish(post().json()["id"])
    refused = post()
    is_problem(refused, 429, "quota")
    assert refused.headers["retry-after"] == "86400"
    monkeypatch.setattr(served.jobs, "clock", lambda: now + 86400)
    assert post().status_code == 202


def test_of_the_settings_unless_the_key_has_its_own(settings, broker):
    limited = settings.model_copy(update={"quota_active_cases": 1})
    with TestClient(create_app(limited, broker, sweep=False), base_url=URL, client=LOOPBACK) as client:
        keys = client.app.state.services.keys
        taken = {}
        for quota in (None, 3, 0):
            header = {"Authorization": f"Bearer {keys.create('a', ['write'], active_cases=quota)[1]}"}
            answers = [client.post("/v1/simulations", json={}, headers=header).status_code for _ in range(5)]
            taken[quota] = answers.count(202)
    assert taken == {None: 1, 3: 3, 0: 5}


def test_a_study_counts_with_all_its_cases(client, served, is_problem):
    secret = served.keys.create("portal", ["read", "write"], active_cases=3)[1]
    header = {"Authorization": f"Bearer {secret}", "Idempotency-Key": "one"}
    axes = [{"kind": "grid", "field": "seed", "values": [1, 2, 3, 4]}]
    study = {"base": {}, "axes": axes}
    refused = client.post("/v1/studies", json=study, headers=header)
    is_problem(refused, 429, "quota")
    assert "retry-after" not in refused.headers  # it will never do
    axes[0]["values"] = [1, 2, 3]
    answer = client.post("/v1/studies?priority=interactive", json=study, headers=header | {"Idempotency-Key": "two"})
    assert answer.status_code == 202, answer.text
    cases = client.get("/v1/simulations", headers=header).json()["items"]
    assert [case["queue"] for case in cases] == ["interactive"] * 3
    assert {case["request_id"] for case in cases} == {answer.headers["x-request-id"]}


def test_a_refusal_can_be_repeated(client, served, finish, is_problem):
    """The same Idempotency-Key is good for the try that succeeds."""
    secret = served.keys.create("portal", ["write"], active_cases=1)[1]
    header = {"Authorization": f"Bearer {secret}", "Idempotency-Key": "again"}
    first = client.post("/v1/simulations", json={}, headers=header | {"Idempotency-Key": "first"}).json()["id"]
    is_problem(client.post("/v1/simulations", json={}, headers=header), 429, "quota")
    finish(first)
    assert client.post("/v1/simulations", json={}, headers=header).status_code == 202


def test_many_at_once(post_with):
    post = post_with(active_cases=3)
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: post().status_code, range(16)))
    assert answers.count(202) == 3
    assert answers.count(429) == 13
