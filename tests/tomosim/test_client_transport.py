"""The client asks again where that helps, and only there; no service is needed."""

import httpx
import pytest

from tomosim import client as clients
from tomosim.client import Client, Retrying


class Scripted(httpx.BaseTransport):
    """Answers and errors one after the other; remembers the requests."""

    def __init__(self, *script):
        self.script = list(script)
        self.requests = []

    def handle_request(self, request):
        self.requests.append(request)
        what = self.script.pop(0)
        if isinstance(what, Exception):
            raise what
        return what


def scripted(*script, **more) -> tuple[Client, Scripted]:
    transport = Scripted(*script)
    return Client("http://service", transport=transport, retrying=Retrying(first_seconds=0, **more)), transport


def problem(status: int, **headers: str) -> httpx.Response:
    return httpx.Response(status, json={"code": "later", "detail": "not now"}, headers=headers)


OK = httpx.Response(200, json={"items": []})


@pytest.mark.parametrize(
    "trouble",
    [
        problem(429),
        problem(503),
        problem(502),
        httpx.Response(409, json={"code": "idempotency-in-progress"}),
        httpx.ReadError("lost"),
        httpx.ConnectError("refused"),
    ],
)
def test_sent_again_where_that_helps(trouble):
    client, transport = scripted(trouble, trouble, OK)
    assert client.phantoms() == []
    assert len(transport.requests) == 3


def test_a_case_is_sent_again_under_the_same_key():
    client, transport = scripted(httpx.ReadError("lost"), problem(503), problem(422))
    with pytest.raises(clients.InvalidRequestError):
        client.submit({})
    assert len({r.headers["idempotency-key"] for r in transport.requests}) == 1
    assert len(transport.requests) == 3


def test_what_may_have_happened_is_not_done_twice():
    client, transport = scripted(httpx.ReadError("lost"))
    with pytest.raises(clients.UnreachableError):
        client.retry("0" * 32)
    assert len(transport.requests) == 1
    client, transport = scripted(httpx.ConnectError("refused"), problem(409))
    with pytest.raises(clients.ConflictError):
        client.retry("0" * 32)  # it never arrived: no harm in sending it again


def test_it_ends_after_some_attempts():
    client, transport = scripted(*[problem(503)] * 4, attempts=3)
    with pytest.raises(clients.UnavailableError) as gone:
        client.phantoms()
    assert (gone.value.code, gone.value.status, len(transport.requests)) == ("later", 503, 3)


def test_retry_after_is_respected(monkeypatch):
    slept = []
    monkeypatch.setattr("time.sleep", slept.append)
    client, _ = scripted(problem(429, **{"Retry-After": "7"}), OK)
    client.phantoms()
    assert slept == [7.0]
    client, _ = scripted(problem(429, **{"Retry-After": "3600"}))
    with pytest.raises(clients.TooManyRequestsError) as quota:
        client.phantoms()
    assert quota.value.retry_after_seconds == 3600


def test_pauses_grow():
    retrying = Retrying(first_seconds=1.0, longest_seconds=5.0)
    for number, longest in ((1, 1.0), (2, 2.0), (3, 4.0), (4, 5.0), (9, 5.0)):
        assert longest / 2 <= retrying.pause(number) <= longest


def test_events_go_on_after_a_lost_connection():
    def stream(*lines):
        return httpx.Response(200, text="\n".join(lines) + "\n")

    first = stream("id: 1", "event: state", 'data: {"state": "queued"}', "", "id: 2", "event: state")  # cut off
    second = stream(": still here", "", "id: 2", "event: state", 'data: {"state": "running"}', "")
    client, transport = scripted(first, httpx.ReadError("lost"), second)
    seen = []
    client._has_ended = lambda identifier: 2 in seen
    for event in client.events("0" * 32):
        seen.append(event.sequence)
    assert seen == [1, 2]
    assert [r.headers.get("last-event-id") for r in transport.requests] == [None, "1", "1"]


def test_the_key_is_sent(monkeypatch):
    monkeypatch.setenv("TOMOSIM_API_KEY", "secret")
    monkeypatch.setenv("TOMOSIM_URL", "http://elsewhere/")
    transport = Scripted(OK)
    with Client(transport=transport) as client:
        client.phantoms()
    assert str(transport.requests[0].url) == "http://elsewhere/v1/phantoms"
    assert transport.requests[0].headers["authorization"] == "Bearer secret"
