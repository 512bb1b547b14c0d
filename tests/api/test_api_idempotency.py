"""Idempotency-Key: a request that is sent again does nothing again."""

import threading

import pytest

from api.simulations import routes as simulations
from worker.records.idempotency import ABANDONED_SECONDS, Idempotency

KEY_NAME = "Idempotency-Key"
KEY = {KEY_NAME: "8e03978e-40d5-43dd-bc93-6894a57f9324"}
STUDY = {"axes": [{"kind": "grid", "field": "seed", "values": [1, 2]}]}
HOOK = {"url": "https://93.184.216.34/hook"}
PACS = {"name": "pacs", "host": "127.0.0.1", "port": 104, "called_aet": "PACS"}
MADE = [
    ("/v1/simulations", {"seed": 5}),
    ("/v1/studies", STUDY),
    ("/v1/webhooks", HOOK),
    ("/v1/destinations", PACS),
]


@pytest.mark.parametrize(("path", "body"), MADE)
def test_the_same_request_gets_the_same_answer(client, broker, served, path, body):
    first = client.post(path, json=body, headers=KEY)
    sent = list(broker.messages)
    for identifier, _ in sent:
        served.jobs.claim(identifier, "test")  # what has happened since does not show
    again = client.post(path, json=body, headers=KEY)
    assert first.is_success
    assert (again.status_code, again.content) == (first.status_code, first.content)
    for name in ("location", "content-type", "retry-after"):
        assert again.headers.get(name) == first.headers.get(name)
    assert again.headers["location"].endswith(first.json()["id"])
    assert again.headers["idempotency-replayed"] == "true"
    assert "idempotency-replayed" not in first.headers
    assert len(client.get(path).json()["items"]) == 1
    assert broker.messages == sent
    other = client.post(path, json={**body, "name": "other"} if body == PACS else body, headers={KEY_NAME: "another"})
    assert other.json()["id"] != first.json()["id"]


def test_every_post_that_makes_something_says_so(client):
    """Except uploads: a phantom is called by the digest of its content, twice the same is one."""
    makes = {"/v1/phantoms"}
    for path, methods in client.get("/openapi.json").json()["paths"].items():
        operation = methods.get("post", {})
        if any(p["name"].lower() == KEY_NAME.lower() and p["in"] == "header" for p in operation.get("parameters", ())):
            makes.add(path)
    assert makes >= {"/v1/deliveries", "/v1/webhooks/{identifier}/test", *(path for path, _ in MADE)}
    for path, methods in client.get("/openapi.json").json()["paths"].items():
        if "201" in methods.get("post", {}).get("responses", {}):
            assert path in makes


def test_a_test_message_is_made_once(client):
    hook = client.post("/v1/webhooks", json=HOOK).json()["links"]
    first = client.post(hook["test"], headers=KEY)
    again = client.post(hook["test"], headers=KEY)
    assert (again.status_code, again.content) == (202, first.content)
    assert [m["id"] for m in client.get(hook["messages"]).json()["items"]] == [first.json()["id"]]


def test_another_request_with_the_key(client, is_problem):
    client.post("/v1/simulations", json={"seed": 5}, headers=KEY)
    for path, body in (("/v1/simulations", {"seed": 6}), ("/v1/studies", STUDY), ("/v1/simulations?x=1", {"seed": 5})):
        is_problem(client.post(path, json=body, headers=KEY), 422, "idempotency-key-reused")
    assert len(client.get("/v1/simulations").json()["items"]) == 1


@pytest.mark.parametrize("key", ["", "a b", "x" * 256, "é"])
def test_what_is_no_key(client, is_problem, key):
    response = client.post("/v1/simulations", json={}, headers={"Idempotency-Key": key.encode("latin-1")})
    assert is_problem(response, 422, "invalid-request")["errors"][0]["parameter"].lower() == "idempotency-key"
    assert client.get("/v1/simulations").json()["items"] == []


def test_a_refused_request_does_not_use_up_its_key(client, is_problem):
    is_problem(client.post("/v1/simulations", json={"seed": "5"}, headers=KEY), 422, "invalid-request")
    assert client.post("/v1/simulations", json={"seed": 5}, headers=KEY).status_code == 202


def test_while_the_first_is_under_way(client, served, is_problem, monkeypatch):
    inside, go_on = threading.Event(), threading.Event()
    create = served.jobs.create

    def slow(*args, **kwargs):
        inside.set()
        assert go_on.wait(30)
        return create(*args, **kwargs)

    monkeypatch.setattr(served.jobs, "create", slow)
    answers = []
    first = threading.Thread(target=lambda: answers.append(client.post("/v1/simulations", json={}, headers=KEY)))
    first.start()
    try:
        assert inside.wait(30)
        busy = client.post("/v1/simulations", json={}, headers=KEY)
        assert int(busy.headers["retry-after"]) >= 1
        is_problem(busy, 409, "idempotency-in-progress")
        is_problem(client.post("/v1/simulations", json={"seed": 2}, headers=KEY), 422, "idempotency-key-reused")
    finally:
        go_on.set()
        first.join()
    assert client.post("/v1/simulations", json={}, headers=KEY).content == answers[0].content


@pytest.mark.parametrize(("path", "body"), MADE)
def test_a_crash_after_the_commit(client, served, path, body, monkeypatch):
    """The answer was never kept: who repeats the request finds what was made."""
    monkeypatch.setattr(served.idempotency, "answer", lambda claim, answer: None)
    done = client.post(path, json=body, headers=KEY)
    first = done.json()
    monkeypatch.undo()
    assert client.post(path, json=body, headers=KEY).status_code == 409
    now = served.idempotency.clock()
    monkeypatch.setattr(served.idempotency, "clock", lambda: now + ABANDONED_SECONDS + 1)
    again = client.post(path, json=body, headers=KEY)
    assert (again.status_code, again.json()["id"]) == (done.status_code, first["id"])
    assert again.json().get("secret") == first.get("secret")  # a client that lost the first answer never saw it
    assert again.headers["location"].endswith(first["id"])
    assert len(client.get(path).json()["items"]) == 1


def test_a_crash_after_the_commit_of_a_test_message(client, served, monkeypatch):
    hook = client.post("/v1/webhooks", json=HOOK).json()["links"]
    monkeypatch.setattr(served.idempotency, "answer", lambda claim, answer: None)
    first = client.post(hook["test"], headers=KEY).json()
    monkeypatch.undo()
    now = served.idempotency.clock()
    monkeypatch.setattr(served.idempotency, "clock", lambda: now + ABANDONED_SECONDS + 1)
    assert client.post(hook["test"], headers=KEY).json()["id"] == first["id"]
    assert len(client.get(hook["messages"]).json()["items"]) == 1


def test_a_mistake_on_our_side_can_be_repeated_at_once(client, served, monkeypatch):
    def broken(*args):
        raise RuntimeError("for the test")

    monkeypatch.setattr(simulations, "simulation_resource", broken)
    with pytest.raises(RuntimeError):
        client.post("/v1/simulations", json={}, headers=KEY)
    monkeypatch.undo()
    again = client.post("/v1/simulations", json={}, headers=KEY)
    assert again.status_code == 202
    assert [s["id"] for s in client.get("/v1/simulations").json()["items"]] == [again.json()["id"]]


def test_a_slow_request_that_was_given_up(client, served, monkeypatch, is_problem):
    """Two requests believe that they are the one: the second to write finds the row there."""
    create = served.jobs.create

    def taken(*args, identifier, **kwargs):
        create(*args, identifier=identifier, **kwargs)
        return create(*args, identifier=identifier, **kwargs)

    monkeypatch.setattr(served.jobs, "create", taken)
    is_problem(client.post("/v1/simulations", json={}, headers=KEY), 409, "idempotency-in-progress")


def test_other_posts_of_the_router_take_keys_too(client, post):
    case = post()
    cancelled = client.post(f"{case['links']['self']}/cancel", headers=KEY)
    again = client.post(f"{case['links']['self']}/cancel", headers=KEY)
    assert (again.status_code, again.content) == (202, cancelled.content)
    assert again.headers["idempotency-replayed"] == "true"


def test_keys_expire(client, served, settings, monkeypatch):
    first = client.post("/v1/simulations", json={}, headers=KEY).json()
    now = served.idempotency.clock()
    later = Idempotency(served.jobs.engine, 1.0, clock=lambda: now + settings.idempotency_seconds + 1)
    later.forget()
    assert client.post("/v1/simulations", json={"seed": 2}, headers=KEY).json()["id"] != first["id"]
