"""API keys: who is let in, with which scopes, and what stays open."""

import base64

import pytest
from fastapi.testclient import TestClient

from api.app import create_app

URL = "http://127.0.0.1"
PUBLIC = {"/livez", "/readyz"}
ADMIN_SECRET = "an-administrator's-key-of-32-characters"


def bearer(secret: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {secret}"}


@pytest.fixture
def secret(served) -> str:
    return served.keys.create("portal", ["read"])[1]


def test_without_keys_this_machine_may_do_everything(client):
    assert client.post("/v1/simulations", json={}).status_code == 202


def test_a_key_is_needed_as_soon_as_there_is_one(client, secret, is_problem):
    refused = client.get("/v1/simulations")
    is_problem(refused, 401, "unauthorized")
    assert refused.headers["www-authenticate"].startswith("Bearer ")
    assert client.get("/v1/simulations", headers=bearer(secret)).status_code == 200


def test_the_key_may_be_the_password_of_basic(client, secret, is_problem):
    """Browsers and DICOMweb clients know how to ask for it."""

    def basic(text: bytes) -> dict[str, str]:
        return {"Authorization": f"Basic {base64.b64encode(text).decode()}"}

    assert client.get("/v1/simulations", headers=basic(f"me:{secret}".encode())).status_code == 200
    is_problem(client.get("/v1/simulations", headers=basic(b"me:other")), 401, "unauthorized")
    is_problem(client.get("/v1/simulations", headers=basic(b"\xff\xfe:")), 401, "unauthorized")
    is_problem(client.get("/v1/simulations", headers={"Authorization": "Basic #"}), 401, "unauthorized")


@pytest.mark.parametrize(
    "value", ["", "Bearer", "Bearer ", "Bearer x", "Digest a=b", "Bearer tomosim_000000000000_" + "0" * 64]
)
def test_a_wrong_key(client, secret, is_problem, value):
    refused = client.get("/v1/simulations", headers={"Authorization": value})
    is_problem(refused, 401, "unauthorized")
    assert "www-authenticate" in refused.headers


def test_a_wrong_key_is_refused_where_none_is_needed(client, is_problem):
    """Otherwise a mistyped key would show only on the day on which keys are needed."""
    is_problem(client.get("/v1/simulations", headers=bearer("x")), 401, "unauthorized")


def test_the_end_of_another_secret_does_not_fit(client, served, secret, is_problem):
    other = served.keys.create("other", ["read"])[1]
    mixed = secret.rpartition("_")[0] + "_" + other.rpartition("_")[2]
    is_problem(client.get("/v1/simulations", headers=bearer(mixed)), 401, "unauthorized")


def test_only_the_digest_is_stored(served, secret):
    with served.keys.engine.connect() as connection:
        row = connection.exec_driver_sql("SELECT * FROM api_keys").one()
    assert secret.rpartition("_")[2] not in str(row)


def test_a_missing_scope_is_named(client, served, secret, is_problem):
    problem = is_problem(client.post("/v1/simulations", json={}, headers=bearer(secret)), 403, "scope-missing")
    assert "'write'" in problem["detail"]
    writer = served.keys.create("writer", ["write"])[1]
    assert client.post("/v1/simulations", json={}, headers=bearer(writer)).status_code == 202
    is_problem(client.get("/v1/simulations", headers=bearer(writer)), 403, "scope-missing")
    root = served.keys.create("root", ["admin"])[1]
    assert client.get("/v1/simulations", headers=bearer(root)).status_code == 200


def test_revoked_and_expired(client, served, secret, is_problem):
    key = served.keys.find(secret)
    old = served.keys.create("old", ["read"], expires=1.0)[1]
    problem = is_problem(client.get("/v1/simulations", headers=bearer(old)), 401, "unauthorized")
    assert "expired" in problem["detail"]
    assert served.keys.revoke(key.id)
    assert not served.keys.revoke(key.id)
    problem = is_problem(client.get("/v1/simulations", headers=bearer(secret)), 401, "unauthorized")
    assert "revoked" in problem["detail"]
    # What was closed does not open again because no key is good any more.
    is_problem(client.get("/v1/simulations"), 401, "unauthorized")


def test_the_last_use_is_kept(client, served, secret):
    assert served.keys.find(secret).last_used is None
    client.get("/v1/simulations", headers=bearer(secret))
    assert served.keys.find(secret).last_used is not None


def test_the_administrator_of_the_settings(settings, broker, is_problem):
    closed = type(settings).load(**{**settings.model_dump(), "admin_key": ADMIN_SECRET, "host": "0.0.0.0"})
    with TestClient(create_app(closed, broker, sweep=False), base_url="http://tomosim.lan") as client:
        is_problem(client.get("/v1/simulations"), 401, "unauthorized")
        assert client.post("/v1/simulations", json={}, headers=bearer(ADMIN_SECRET)).status_code == 202
        is_problem(client.get("/v1/simulations", headers=bearer(ADMIN_SECRET + "x")), 401, "unauthorized")


def test_without_keys_other_machines_are_refused(settings, broker, is_problem):
    """A server may be bound to more than its settings say; a proxy on this machine tells who asks."""
    with TestClient(create_app(settings, broker, sweep=False), base_url=URL, client=("192.0.2.7", 1)) as client:
        is_problem(client.get("/v1/simulations"), 401, "unauthorized")
        assert client.get("/livez").status_code == 200


def test_nobody_is_let_in_before_the_body_is_read(client, secret, is_problem):
    is_problem(
        client.post("/v1/simulations", content=b"x", headers={"Content-Type": "text/plain"}), 401, "unauthorized"
    )
    is_problem(client.get("/v1/simulations?limit=0"), 401, "unauthorized")
    is_problem(client.get("/v1/simulations/none"), 401, "unauthorized")


def test_every_route_names_its_scope(client, served, is_problem):
    """A route that forgets to is found here, and is closed to those without a key all the same."""
    nothing = served.keys.create("nothing", [])[1]
    for path, operations in client.get("/openapi.json").json()["paths"].items():
        for method in operations:
            if path in PUBLIC:
                assert client.request(method, path).status_code in (200, 503)
                continue
            is_problem(client.request(method, path), 401, "unauthorized")
            is_problem(client.request(method, path, headers=bearer(nothing)), 403, "scope-missing")


def test_foreign_pages(client, served, secret, is_problem):
    """A bearer key is never sent by a browser on its own; a password is."""
    writer = served.keys.create("writer", ["write"])[1]
    foreign = {"Origin": "https://attacker.example"}
    password = {"Authorization": f"Basic {base64.b64encode(f':{writer}'.encode()).decode()}"}
    assert client.post("/v1/simulations", json={}, headers={**foreign, **bearer(writer)}).status_code == 202
    is_problem(client.post("/v1/simulations", json={}, headers={**foreign, **password}), 403, "cross-origin")
    # With a key any name will do: a proxy may have another one.
    named = {"Host": "tomosim.example.org", **bearer(secret)}
    assert client.get("/v1/simulations", headers=named).status_code == 200
