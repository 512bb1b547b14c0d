"""/v1/webhooks: made, looked at, tested, replayed, deleted; refused with words that help."""

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from fastapi.testclient import TestClient
from standardwebhooks.webhooks import Webhook as Verifier

from api.app import create_app
from tests.support.waiting import wait_for
from worker.upkeep import outbound


@pytest.fixture
def make(client):
    def create(**more):
        response = client.post("/v1/webhooks", json={"url": "https://93.184.216.34/hook", **more})
        assert response.status_code == 201, response.text
        return response.json()

    return create


def test_the_secret_is_shown_once(client, make):
    hook = make(description="ours")
    assert hook["secret"].startswith("whsec_")
    assert hook["events"][0] == "simulation.succeeded"
    path = hook["links"]["self"]
    shown = client.get(path).json()
    assert "secret" not in shown
    assert hook["secret"] not in client.get("/v1/webhooks").text
    assert {**shown, "secret": hook["secret"]} == hook
    assert client.delete(path).status_code == 204
    assert client.get("/v1/webhooks").json() == {"items": []}


@pytest.mark.parametrize(
    ("body", "pointer", "words"),
    [
        ({"url": "http://example.org/"}, "/url", "https://"),
        ({"url": "https://10.0.0.1/"}, "/url", "TOMOSIM_WEBHOOK_PRIVATE_HOSTS"),
        ({"url": "https://localhost/"}, "/url", "not a public address"),
        ({"url": 5}, "/url", "string"),
        ({"url": "https://93.184.216.34/", "events": ["all"]}, "/events/0", "simulation.succeeded"),
        ({"url": "https://93.184.216.34/", "events": []}, "/events", "at least 1"),
        ({"url": "https://93.184.216.34/", "secret": "mine"}, "/secret", "not permitted"),
        ({}, "/url", "required"),
        ([], "", "object"),
    ],
)
def test_a_wrong_one_is_refused(client, is_problem, body, pointer, words):
    problem = is_problem(client.post("/v1/webhooks", json=body), 422, "invalid-request")
    assert problem["errors"][0]["pointer"] == pointer
    assert words in problem["errors"][0]["detail"]


def test_what_is_not_there(client, is_problem, make):
    path = make()["links"]["self"]
    for method, missing, code in (
        ("GET", f"/v1/webhooks/{'0' * 32}", "webhook-not-found"),
        ("DELETE", f"/v1/webhooks/{'0' * 32}", "webhook-not-found"),
        ("POST", f"/v1/webhooks/{'0' * 32}/test", "webhook-not-found"),
        ("GET", f"{path}/messages/msg_{'0' * 32}", "message-not-found"),
        ("GET", f"{path}/messages/%00", "message-not-found"),
        ("POST", f"{path}/messages/msg_{'0' * 32}/replay", "message-not-found"),
    ):
        is_problem(client.request(method, missing), 404, code)
    is_problem(client.get(f"{path}/messages?cursor=x"), 400, "bad-cursor")
    is_problem(
        client.post("/v1/webhooks", content="{}", headers={"Content-Type": "text/plain"}), 415, "unsupported-media-type"
    )


def test_a_name_that_is_not_known_yet_is_taken(client, make, monkeypatch):
    async def lookup(host, port):
        raise OSError("no such name")

    monkeypatch.setattr(outbound, "lookup", lookup)
    assert make(url="https://soon.example/hook")["state"] == "active"


def test_the_log_has_pages(client, make):
    path = make()["links"]["self"]
    sent = [client.post(f"{path}/test").json()["id"] for _ in range(3)]
    first = client.get(f"{path}/messages?limit=2").json()
    second = client.get(f"{path}/messages", params={"limit": 2, "cursor": first["next"]}).json()
    assert second["next"] is None
    assert sorted(m["id"] for m in first["items"] + second["items"]) == sorted(sent)
    pending = client.get(first["items"][0]["links"]["self"]).json()
    assert json.loads(pending["body"])["type"] == "webhook.test"
    assert (pending["state"], pending["log"]) == ("pending", [])
    assert client.post(f"{pending['links']['self']}/replay").json()["code"] == "not-finished"


def test_from_the_end_of_a_case_to_a_verified_message(settings, broker):
    """Through the running courier to a receiver on this machine, which fails it."""
    got = []

    class Receiver(BaseHTTPRequestHandler):
        def do_POST(self):
            got.append((dict(self.headers), self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *args):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Receiver)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    allowed = settings.model_copy(update={"webhook_private_hosts": "127.0.0.1"})
    try:
        with TestClient(
            create_app(allowed, broker), base_url="http://127.0.0.1", client=("127.0.0.1", 50000)
        ) as client:
            hook = client.post("/v1/webhooks", json={"url": f"http://127.0.0.1:{server.server_port}/hook"}).json()
            case = client.post("/v1/simulations", json={"name": "told"}).json()
            client.post(f"{case['links']['self']}/cancel")
            messages = f"{hook['links']['self']}/messages"
            message = wait_for(
                lambda: (m := client.get(messages).json()["items"][0])["state"] == "delivered" and m, "the delivery"
            )
            shown = client.get(message["links"]["self"]).json()
    finally:
        server.shutdown()
        server.server_close()
    ((headers, body),) = got
    content = Verifier(hook["secret"]).verify(body, headers)
    assert (content["type"], content["data"]["id"]) == ("simulation.cancelled", case["id"])
    assert headers["webhook-id"] == message["id"]
    assert [(a["number"], a["status"], a["error"]) for a in shown["log"]] == [(1, 200, "")]
