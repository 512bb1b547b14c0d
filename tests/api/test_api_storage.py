"""Below the free-space floor nothing new is taken; a store that cannot be reached is said."""

import pytest
from fastapi.testclient import TestClient

from api.app import create_app

PAIR = {"axes": [{"kind": "grid", "field": "seed", "values": [1, 2]}]}


@pytest.fixture
def full(settings, broker):
    """The API where the disk has less than it is to have."""
    changed = settings.model_copy(update={"min_free_bytes": 1 << 60})
    with TestClient(
        create_app(changed, broker, sweep=False), base_url="http://127.0.0.1", client=("127.0.0.1", 50000)
    ) as http:
        yield http


def test_nothing_new_is_taken(full, is_problem):
    refused = is_problem(full.post("/v1/simulations", json={}), 507, "storage-full")
    assert "GB free" in refused["detail"]
    is_problem(full.post("/v1/studies", json=PAIR), 507, "storage-full")
    headers = {"Content-Type": "application/octet-stream"}
    is_problem(full.post("/v1/phantoms", content=b"NRRD", headers=headers), 507, "storage-full")
    assert full.get("/v1/simulations").json()["items"] == []


def test_it_is_not_ready_but_answers(full, is_problem):
    checks = is_problem(full.get("/readyz"), 503, "not-ready")["checks"]
    assert "GB free" in checks["storage"]
    assert checks["database"] == "ok"
    assert full.get("/livez").status_code == 200
    assert full.get("/v1/simulations").status_code == 200


def test_a_store_that_does_not_answer(settings, broker, is_problem):
    changes = {"store_url": "s3://stages/x", "store_endpoint": "http://127.0.0.1:9"}
    changes |= {"store_access_key": "a", "store_secret_key": "b"}
    app = create_app(settings.model_copy(update=changes), broker, sweep=False)
    with TestClient(app, base_url="http://127.0.0.1", client=("127.0.0.1", 50000)) as client:
        refused = is_problem(client.get("/v1/phantoms"), 503, "store-unavailable")
        assert "http://127.0.0.1:9" in refused["detail"]
        assert "http://127.0.0.1:9" in is_problem(client.get("/readyz"), 503, "not-ready")["checks"]["storage"]
