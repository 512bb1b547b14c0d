"""Server-sent events: everything once, in order, from where the client left off."""

import json
import threading

import pytest
from sqlalchemy.exc import OperationalError

from api.http.streams import _news
from worker.records.jobs import StageProgress


def parse(text):
    """[(id, event, data)] of a stream."""
    events = []
    for block in text.split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
        if "data" in fields:
            events.append((int(fields["id"]), fields["event"], json.loads(fields["data"])))
    return events


@pytest.fixture
def case(post, served):
    row = post()
    served.jobs.claim(row["id"], "test")
    served.jobs.progress(row["id"], "test", StageProgress("mesh", 1, 8, 0.5, "half"))
    served.jobs.fail(row["id"], "test", {"kind": "system", "code": "timeout", "message": "too long"})
    return row


def test_the_whole_story(client, case):
    response = client.get(case["links"]["events"])
    assert response.headers["content-type"].startswith("text/event-stream")
    assert response.text.startswith("retry: ")
    events = parse(response.text)
    assert [(i, kind) for i, kind, _ in events] == [(1, "state"), (2, "state"), (3, "progress"), (4, "state")]
    assert events[2][2]["stage"] == "mesh"
    assert (events[3][2]["state"], events[3][2]["error"]["code"]) == ("failed", "timeout")
    assert [data["at"] for *_, data in events] == sorted(data["at"] for *_, data in events)


@pytest.mark.parametrize(("seen", "expected"), [("0", [1, 2, 3, 4]), ("2", [3, 4]), ("4", []), ("99", [])])
def test_resume(client, case, seen, expected):
    response = client.get(case["links"]["events"], headers={"Last-Event-ID": seen})
    assert [i for i, *_ in parse(response.text)] == expected


@pytest.mark.parametrize("seen", ["-1", "x", "1.5", "9" * 40, "0x1"])
def test_nonsense(client, case, is_problem, seen):
    is_problem(client.get(case["links"]["events"], headers={"Last-Event-ID": seen}), 400, "bad-event-id")


def test_a_live_stream_ends_with_the_case(client, post, served, monkeypatch):
    monkeypatch.setattr("api.http.streams.FIRST_POLL_SECONDS", 0.02)
    monkeypatch.setattr("api.http.streams.HEARTBEAT_SECONDS", 0.05)
    row = post()
    thread = threading.Timer(0.5, lambda: served.jobs.cancel(row["id"]))
    thread.start()
    text = client.get(row["links"]["events"]).text
    thread.join()
    assert [data["state"] for *_, data in parse(text)] == ["queued", "cancelled"]
    assert ": still here" in text


def test_the_end_is_told_before_the_stream_ends(served, case, monkeypatch):
    """The case may end between the look at its events and the look at its state."""
    assert _news(served.jobs, case["id"], 4) == ([], True)
    events, ended = _news(served.jobs, case["id"], 3)
    assert [event.sequence for event in events] == [4]
    assert ended
    monkeypatch.setattr(served.jobs, "events_after", lambda *args: [])
    assert _news(served.jobs, case["id"], 3) == ([], False)


def test_a_stream_waits_for_the_database(client, case, served, monkeypatch):
    read = served.jobs.events_after
    away = iter([OperationalError("SELECT 1", {}, ConnectionError())] * 3)

    def read_later(*args):
        for error in away:
            raise error
        return read(*args)

    monkeypatch.setattr(served.jobs, "events_after", read_later)
    assert [event for _, event, _ in parse(client.get(case["links"]["events"]).text)][-1] == "state"


def test_a_retried_case_goes_on(client, case, served, monkeypatch):
    monkeypatch.setattr("api.http.streams.FIRST_POLL_SECONDS", 0.02)
    served.jobs.retry(case["id"])
    thread = threading.Timer(0.3, lambda: served.jobs.cancel(case["id"]))
    thread.start()
    events = parse(client.get(case["links"]["events"], headers={"Last-Event-ID": "3"}).text)
    thread.join()
    assert [data["state"] for *_, data in events] == ["failed", "queued", "cancelled"]


def test_forgotten_while_watched(client, post, served, monkeypatch):
    monkeypatch.setattr("api.http.streams.FIRST_POLL_SECONDS", 0.02)
    row = post()

    def forget():
        served.jobs.cancel(row["id"])
        served.jobs.delete(row["id"])

    thread = threading.Timer(0.3, forget)
    thread.start()
    text = client.get(row["links"]["events"]).text
    thread.join()
    assert parse(text)[0][2]["state"] == "queued"
