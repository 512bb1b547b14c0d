"""Presets, schemas, service information, health, metrics and the page."""

import base64
import hashlib
import re

import jsonschema
import pytest

from simcore import presets
from simcore.spec import SimulationSpec


def test_presets(client, is_problem):
    listed = [item["name"] for item in client.get("/v1/presets").json()["items"]]
    assert listed == presets.names()
    one = client.get(f"/v1/presets/{listed[0]}").json()
    assert SimulationSpec.from_dict(one["specification"]) == presets.get(listed[0])
    assert one["description"] == presets.describe(listed[0])
    is_problem(client.get("/v1/presets/none"), 404, "preset-not-found")


def test_a_preset_can_be_posted(client):
    specification = client.get("/v1/presets/tiny").json()["specification"]
    assert client.post("/v1/simulations", json=specification).status_code == 202


def test_schemas(client, is_problem):
    assert client.get("/v1/schemas").json()["items"] == [
        {"name": name, "href": f"/v1/schemas/{name}"} for name in ("simulation", "study", "reading")
    ]
    response = client.get("/v1/schemas/simulation")
    assert response.headers["content-type"] == "application/schema+json"
    schema = response.json()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(presets.get("tiny").model_dump(mode="json"), schema)
    is_problem(client.get("/v1/schemas/none"), 404, "schema-not-found")


def test_service_info(client, settings):
    body = client.get("/v1/service-info").json()
    assert (body["name"], body["api_version"]) == ("tomosim", "v1")
    assert body["limits"]["memory_bytes"] == settings.memory_limit


def test_openapi_describes_the_specification(client):
    description = client.get("/openapi.json").json()
    components = description["components"]["schemas"]
    body = description["paths"]["/v1/simulations"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    assert body["$ref"].rpartition("/")[2] in components
    assert {"SimulationSpec", "Problem", "AcquisitionSpec"} <= set(components)
    assert "#/$defs/" not in client.get("/openapi.json").text
    references = set(re.findall(r'"#/components/schemas/([^"]+)"', client.get("/openapi.json").text))
    assert references <= set(components)
    identifiers = [o["operationId"] for p in description["paths"].values() for o in p.values()]
    assert len(identifiers) == len(set(identifiers))


def test_livez_touches_nothing(client, served, broker):
    broker.down = True
    served.jobs.engine.dispose()
    assert client.get("/livez").json() == {"status": "ok"}


def test_readyz(client, served, broker, is_problem):
    problem = is_problem(client.get("/readyz"), 503, "not-ready")
    assert problem["checks"]["worker"] != "ok"
    assert {problem["checks"][name] for name in ("database", "broker", "storage")} == {"ok"}
    served.fleet.beat("one", 1)
    assert client.get("/readyz").status_code == 200
    broker.down = True
    problem = is_problem(client.get("/readyz"), 503, "not-ready")
    assert problem["checks"]["broker"] == "connection refused"
    broker.down = False
    served.store.workspaces.min_free_bytes = 1 << 60
    assert "GB free" in is_problem(client.get("/readyz"), 503, "not-ready")["checks"]["storage"]


def test_page(client):
    response = client.get("/")
    assert response.headers["content-type"].startswith("text/html")
    assert "http://" not in response.text.replace("http://127.0.0.1", "")
    assert "https://" not in response.text
    policy = response.headers["content-security-policy"]
    for tag in ("script", "style"):
        body = re.search(rf"<{tag}>(.*?)</{tag}>", response.text, re.DOTALL).group(1)
        assert base64.b64encode(hashlib.sha256(body.encode()).digest()).decode() in policy
    assert "innerHTML" not in response.text


def test_the_reference_works_without_a_network(client):
    response = client.get("/docs")
    assert response.headers["content-type"].startswith("text/html")
    assert "script" not in response.text
    assert not re.search(r"(src|href)=\"(https?:)?//", response.text)
    style = re.search(r"<style>(.*?)</style>", response.text, re.DOTALL).group(1)
    policy = response.headers["content-security-policy"]
    assert base64.b64encode(hashlib.sha256(style.encode()).digest()).decode() in policy
    description = client.get("/openapi.json").json()
    for path, operations in description["paths"].items():
        for method in operations:
            assert f'<span class="method">{method.upper()}</span> <code>{path}</code>' in response.text


@pytest.mark.parametrize("path", ["/v1/presets", "/v1/schemas", "/v1/service-info", "/livez", "/metrics", "/"])
def test_no_trailing_slash(client, path, is_problem):
    if path != "/":
        is_problem(client.get(path + "/"), 404, "not-found")
