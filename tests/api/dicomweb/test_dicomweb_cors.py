"""Pages of other origins: nothing by default; the origins of the settings may read /dicomweb and nothing else."""

import pytest
from fastapi.testclient import TestClient

from api.app import create_app
from tests.support.brokers import SilentBroker
from worker.settings import Settings, SettingsError

VIEWER = "http://viewer.example.org:3000"
PREFLIGHT = {"Origin": VIEWER, "Access-Control-Request-Method": "GET"}


@pytest.fixture(scope="module")
def shared(settings):
    chosen = settings.model_copy(update={"cors_origins": f"https://other.example.org, {VIEWER}"})
    with TestClient(
        create_app(chosen, SilentBroker(), sweep=False), base_url="http://127.0.0.1", client=("127.0.0.1", 50000)
    ) as http:
        yield http


def test_off_by_default(client):
    assert "access-control-allow-origin" not in client.get("/dicomweb/studies", headers={"Origin": VIEWER}).headers
    assert client.options("/dicomweb/studies", headers=PREFLIGHT).status_code == 405


def test_preflight_with_the_headers_of_a_viewer(shared):
    asking = {**PREFLIGHT, "Access-Control-Request-Headers": "authorization,accept,x-requested-with"}
    answer = shared.options("/dicomweb/studies", headers={**asking, "Access-Control-Request-Private-Network": "true"})
    assert answer.status_code == 200
    assert answer.headers["access-control-allow-origin"] == VIEWER
    assert "authorization" in answer.headers["access-control-allow-headers"]
    assert answer.headers["access-control-allow-private-network"] == "true"
    assert "access-control-allow-credentials" not in answer.headers


def test_answers_and_errors_can_be_read(shared):
    for path, status in (("/dicomweb/studies", 200), ("/dicomweb/studies/x", 400)):
        answer = shared.get(path, headers={"Origin": VIEWER})
        assert answer.status_code == status
        assert answer.headers["access-control-allow-origin"] == VIEWER
        assert "Origin" in answer.headers["vary"]
        assert "Warning" in answer.headers["access-control-expose-headers"]


@pytest.mark.parametrize("origin", ["http://evil.example.org", "null", "http://viewer.example.org:3000.evil.org"])
def test_other_origins(shared, origin):
    assert "access-control-allow-origin" not in shared.get("/dicomweb/studies", headers={"Origin": origin}).headers
    assert shared.options("/dicomweb/studies", headers={**PREFLIGHT, "Origin": origin}).status_code == 400


@pytest.mark.parametrize("path", ["/v1/simulations", "/", "/dicomwebbing", "/v1/dicomweb/studies"])
def test_nothing_but_dicomweb(shared, path):
    assert "access-control-allow-origin" not in shared.get(path, headers={"Origin": VIEWER}).headers


def test_only_reading(shared):
    assert (
        shared.options("/dicomweb/studies", headers={**PREFLIGHT, "Access-Control-Request-Method": "POST"}).status_code
        == 400
    )


@pytest.mark.parametrize("value", ["*", "viewer.example.org", "https://viewer.example.org/", "https://a b", "ftp://x"])
def test_what_is_no_origin_is_refused(value):
    with pytest.raises(SettingsError, match="TOMOSIM_CORS_ORIGINS"):
        Settings.load(cors_origins=value)
