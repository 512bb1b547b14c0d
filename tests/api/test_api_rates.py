"""Rate limits and slow bodies: 429 with Retry-After for whoever is too fast, 408 for whoever is too slow."""

import asyncio

import pytest
from fastapi.testclient import TestClient

from api.app import create_app
from api.http import slow
from api.http.errors import ApiError
from api.http.rates import Rates
from worker.settings import Settings

URL, LOOPBACK = "http://127.0.0.1", ("127.0.0.1", 50000)


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def limited(settings, broker):
    slow_settings = settings.model_copy(update={"rate_per_second": 0.5, "rate_burst": 3})
    with TestClient(create_app(slow_settings, broker, sweep=False), base_url=URL, client=LOOPBACK) as client:
        client.app.state.services.rates.clock = lambda: 100.0
        yield client


def bearer(client, name="portal") -> dict[str, str]:
    return {"Authorization": f"Bearer {client.app.state.services.keys.create(name, ['read'])[1]}"}


def test_each_key_has_its_own_bucket(limited, is_problem):
    header = bearer(limited)
    answers = [limited.get("/v1/presets", headers=header) for _ in range(4)]
    assert [a.status_code for a in answers] == [200, 200, 200, 429]
    is_problem(answers[-1], 429, "rate-limit")
    assert answers[-1].headers["retry-after"] == "2"
    assert limited.get("/v1/presets", headers=bearer(limited, "other")).status_code == 200


def test_an_address_that_tries_keys(limited, is_problem):
    codes = [limited.get("/v1/presets", headers={"Authorization": f"Bearer {n}"}).status_code for n in range(4)]
    assert codes == [401, 401, 401, 429]
    assert limited.get("/livez").status_code == 200


def test_this_machine_without_keys_is_not_limited(limited):
    assert [limited.get("/v1/presets").status_code for _ in range(5)] == [200] * 5


@pytest.mark.needs_redis
def test_processes_share_their_buckets(settings, redis_url):
    changed = {"rate_per_second": 0.001, "rate_burst": 4, "broker_url": redis_url}
    one, other = (Rates(Settings.load(**{**settings.model_dump(), **changed})) for _ in range(2))
    assert [rates.take("a") > 0 for rates in (one, other, one, other, one, other)] == [False] * 4 + [True] * 2
    assert 990 < one.take("a") <= 1000
    assert one.take("b") == 0
    one.close()
    other.close()


def test_the_bucket_refills(settings):
    clock = Clock()
    changed = {"rate_per_second": 2.0, "rate_burst": 2, "broker_url": "redis://127.0.0.1:1/0"}  # no broker answers
    rates = Rates(settings.model_copy(update=changed), clock)
    assert [rates.take("a") for _ in range(3)] == [0, 0, 0.5]
    clock.now += 0.5
    assert [rates.take("a") for _ in range(2)] == [0, 0.5]
    clock.now += 60
    assert [rates.take("a") for _ in range(3)] == [0, 0, 0.5]


def test_no_limit(settings):
    rates = Rates(settings.model_copy(update={"rate_per_second": 0.0}))
    assert {rates.take("a") for _ in range(1000)} == {0.0}


def test_a_body_that_stops_coming(monkeypatch):
    monkeypatch.setattr(slow, "GRACE_SECONDS", 0.05)
    chunks = [{"type": "http.request", "body": b"{", "more_body": True}]

    async def receive():
        return chunks.pop() if chunks else await asyncio.sleep(3600)

    async def application(scope, receive, send):
        while (await receive()).get("more_body"):
            pass

    async def ask():
        await slow.SlowBodies(application)({"type": "http"}, receive, None)

    with pytest.raises(ApiError) as refused:
        asyncio.run(ask())
    assert (refused.value.status, refused.value.code) == (408, "too-slow")


def test_who_waits_for_the_answer_is_not_hurried(monkeypatch):
    """After the body the same channel tells that the client has gone: a stream may listen there for hours."""
    monkeypatch.setattr(slow, "GRACE_SECONDS", 0.1)
    messages = [{"type": "http.disconnect"}, {"type": "http.request", "body": b"", "more_body": False}]

    async def receive():
        message = messages.pop()
        await asyncio.sleep(0 if messages else 0.3)
        return message

    async def application(scope, receive, send):
        assert (await receive())["type"] == "http.request"
        assert (await receive())["type"] == "http.disconnect"

    asyncio.run(slow.SlowBodies(application)({"type": "http"}, receive, None))
