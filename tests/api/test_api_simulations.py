"""/v1/simulations: the life of a case as a client sees it."""

import json
import re

import pytest

from simcore.spec import SimulationSpec

ERROR = {"kind": "simulation", "code": "solver-failed", "message": "use less compression"}


def test_post_answers_at_once(client, broker, served):
    response = client.post("/v1/simulations", json={"name": "mine", "seed": 5})
    assert response.status_code == 202
    body = response.json()
    assert (body["state"], body["name"], body["attempt"]) == ("queued", "mine", 0)
    assert body["specification"] == SimulationSpec(name="mine", seed=5).model_dump(mode="json")
    assert body["estimate"]["memory_bytes"] > 0
    assert response.headers["location"] == f"http://127.0.0.1/v1/simulations/{body['id']}"
    assert int(response.headers["retry-after"]) >= 1
    assert client.get(response.headers["location"]).json()["id"] == body["id"]
    assert broker.messages == [(body["id"], "interactive")]
    assert served.jobs.get(body["id"]).sent is not None


def test_a_broker_that_is_down_refuses_nothing(client, broker, served):
    broker.down = True
    response = client.post("/v1/simulations", json={})
    assert response.status_code == 202
    assert [row.id for row in served.jobs.unsent()] == [response.json()["id"]]


def test_estimate_keeps_nothing(client, broker):
    response = client.post("/v1/simulations/estimate", json={"phantom": {"voxel_mm": 0.4}})
    assert response.status_code == 200
    assert set(response.json()) == {"voxels", "memory_bytes", "storage_bytes", "output_bytes", "seconds", "remarks"}
    assert response.json()["remarks"] == []
    idle = client.post("/v1/simulations/estimate", json={"export": {"oblique_angle_degrees": 60.0}})
    assert idle.json()["remarks"] == ["export.oblique_angle_degrees is not used: export.view is 'CC'"]
    assert client.get("/v1/simulations").json()["items"] == []
    assert broker.messages == []


@pytest.mark.parametrize("path", ["/v1/simulations", "/v1/simulations/estimate"])
class TestRefusals:
    def test_wrong_fields_are_named(self, client, is_problem, path):
        body = {"phantom": {"voxel_mm": "0.2", "colour": "red"}, "seed": -1}
        problem = is_problem(client.post(path, json=body), 422, "invalid-request")
        errors = {e["pointer"]: e for e in problem["errors"]}
        assert set(errors) == {"/phantom/voxel_mm", "/phantom/colour", "/seed"}
        assert errors["/phantom/voxel_mm"]["value"] == "0.2"
        assert "voxel_mm" in errors["/phantom/colour"]["detail"]
        assert client.get("/v1/simulations").json()["items"] == []

    def test_what_dicom_cannot_hold(self, client, is_problem, path):
        """Known before anything runs, with what passes instead."""
        body = {"compression": {"percent": 20.0}, "reconstruction": {"kind": "fbp", "slice_mm": 0.1}}
        problem = is_problem(client.post(path, json=body), 422, "resource-limit")
        assert problem["errors"][0]["pointer"] == "/reconstruction/slice_mm"
        slice_mm = float(re.search(r"slice_mm = (\S+) or more", problem["detail"])[1])
        body["reconstruction"]["slice_mm"] = slice_mm
        assert client.post(path, json=body).status_code in (200, 202)

    @pytest.mark.parametrize(
        "body",
        [b"{", b"", b"[]", b"17", b"null", b'{"seed": NaN}', b'{"seed": 1e999}', b'{"name": "\\ud800"}', b"\xff\xfe"],
    )
    def test_what_is_no_specification(self, client, is_problem, path, body):
        response = client.post(path, content=body, headers={"Content-Type": "application/json"})
        assert is_problem(response, 422, "invalid-request")["errors"]

    def test_too_costly(self, client, is_problem, path):
        problem = is_problem(client.post(path, json={"phantom": {"voxel_mm": 0.05}}), 422, "resource-limit")
        assert "8.0 GB are allowed" in problem["detail"]

    def test_impossible_geometry(self, client, is_problem, path):
        body = {"acquisition": {"detector": {"pixels_x": 100}}}
        problem = is_problem(client.post(path, json=body), 422, "invalid-request")
        assert problem["errors"][0]["pointer"] == "/acquisition/detector/pixels_x"
        assert problem["reason"] == "geometry-not-possible"

    def test_too_long(self, client, is_problem, path):
        body = json.dumps({"name": "x" * 1_000_001})
        is_problem(client.post(path, content=body, headers={"Content-Type": "application/json"}), 413, "too-large")

    def test_too_long_without_saying_so(self, client, is_problem, path):
        def chunks():
            for _ in range(20):
                yield b" " * 100_000

        response = client.post(path, content=chunks(), headers={"Content-Type": "application/json"})
        is_problem(response, 413, "too-large")

    @pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", ""])
    def test_not_json(self, client, is_problem, path, kind):
        response = client.post(path, content=b"{}", headers={"Content-Type": kind})
        is_problem(response, 415, "unsupported-media-type")


def test_full_disk(client, served, is_problem):
    served.store.workspaces.min_free_bytes = 1 << 60
    is_problem(client.post("/v1/simulations", json={}), 507, "storage-full")
    assert client.get("/v1/simulations").json()["items"] == []


def test_entity_tag_follows_the_revision(client, post, served):
    case = post()
    path = case["links"]["self"]
    first = client.get(path)
    tag = first.headers["etag"]
    assert tag == f'W/"{case["revision"]}"'
    assert "retry-after" in first.headers
    for header in (tag, f'"other", {tag}', "*", tag.removeprefix("W/")):
        same = client.get(path, headers={"If-None-Match": header})
        assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", tag)
    served.jobs.claim(case["id"], "test")
    changed = client.get(path, headers={"If-None-Match": tag})
    assert (changed.status_code, changed.json()["state"]) == (200, "running")
    assert changed.json()["progress"]["seconds_left"] is not None


def test_progress_and_failure_are_shown(client, post, served):
    from worker.records.jobs import StageProgress

    case = post()
    served.jobs.claim(case["id"], "test")
    served.jobs.progress(case["id"], "test", StageProgress("fem", 2, 8, 0.25, "step 1"))
    progress = client.get(case["links"]["self"]).json()["progress"]
    assert (progress["stage"], progress["stages_done"], progress["stages_total"]) == ("fem", 2, 8)
    assert (progress["fraction"], progress["message"]) == (0.25, "step 1")
    served.jobs.fail(case["id"], "test", ERROR)
    body = client.get(case["links"]["self"]).json()
    assert body["state"] == "failed"
    assert body["error"] == {**ERROR, "problems": []}
    assert body["finished_at"].endswith("Z")
    assert "retry" in body["links"]


def test_results_of_a_case_that_succeeded(client, done):
    body = client.get(done).json()
    assert (body["state"], body["results"]) == ("succeeded", {"volume_ml": 700.0})
    assert {"artifacts", "archive", "manifest"} <= set(body["links"])
    assert "retry-after" not in client.get(done).headers


def test_list_in_pages(client, post):
    identifiers = [post(name=f"case {n}")["id"] for n in range(5)]
    url, seen = "/v1/simulations?limit=2&state=queued", []
    while url:
        response = client.get(url)
        body = response.json()
        seen += [item["id"] for item in body["items"]]
        assert all(item["specification"] is None for item in body["items"])
        assert (body["next"] is None) == ("link" not in response.headers)
        url = response.links["next"]["url"] if "next" in response.links else None
    assert seen == identifiers[::-1]


def test_list_by_state(client, post, done):
    waiting = post()["id"]
    listed = {
        s: [i["id"] for i in client.get(f"/v1/simulations?state={s}").json()["items"]] for s in ("queued", "failed")
    }
    assert listed == {"queued": [waiting], "failed": []}


@pytest.mark.parametrize("cursor", ["nonsense", "", "e30", "W10", "WyJhIiwgMV0", "W05hTiwgImEiXQ", "a" * 5000, "%00"])
def test_bad_cursor(client, is_problem, cursor):
    is_problem(client.get(f"/v1/simulations?cursor={cursor}"), 400, "bad-cursor")


@pytest.mark.parametrize("query", ["limit=0", "limit=201", "limit=x", "state=lost"])
def test_bad_query(client, is_problem, query):
    problem = is_problem(client.get(f"/v1/simulations?{query}"), 422, "invalid-request")
    assert problem["errors"][0]["parameter"] == query.partition("=")[0]


def test_cancel(client, post, served, is_problem):
    queued = post()
    answer = client.post(queued["links"]["cancel"])
    assert (answer.status_code, answer.json()["state"]) == (202, "cancelled")
    assert client.post(queued["links"]["cancel"]).status_code == 202
    running = post()
    served.jobs.claim(running["id"], "test")
    answer = client.post(running["links"]["cancel"])
    assert (answer.status_code, answer.json()["state"]) == (202, "cancelling")


def test_cancel_of_finished(client, done, is_problem):
    is_problem(client.post(f"{done}/cancel"), 409, "already-finished")


def test_retry(client, post, served, broker, is_problem):
    case = post()
    path = case["links"]["self"]
    is_problem(client.post(f"{path}/retry"), 409, "not-finished")
    served.jobs.claim(case["id"], "test")
    served.jobs.fail(case["id"], "test", ERROR)
    answer = client.post(f"{path}/retry")
    assert (answer.status_code, answer.json()["state"], answer.json()["error"]) == (202, "queued", None)
    assert answer.headers["location"].endswith(path)
    assert len(broker.messages) == 2


def test_retry_of_succeeded(client, done, is_problem):
    is_problem(client.post(f"{done}/retry"), 409, "already-finished")


def test_delete(client, post, done, is_problem):
    is_problem(client.delete(post()["links"]["self"]), 409, "not-finished")
    answer = client.delete(done)
    assert (answer.status_code, answer.content) == (204, b"")
    is_problem(client.get(done), 404, "simulation-not-found")


PATHS = ["", "/events", "/artifacts", "/artifacts/volume.dcm", "/archive", "/manifest"]


@pytest.mark.parametrize("identifier", ["0" * 32, "no-such-thing", "%2e%2e", "%00", "x" * 300])
@pytest.mark.parametrize("path", PATHS)
def test_unknown(client, is_problem, identifier, path):
    is_problem(client.get(f"/v1/simulations/{identifier}{path}"), 404, "simulation-not-found")


@pytest.mark.parametrize(
    ("path", "allowed"),
    [
        ("/v1/simulations", "GET, HEAD, POST"),
        ("/v1/simulations/x", "GET, HEAD, DELETE"),
        ("/v1/simulations/x/cancel", "POST"),
        ("/v1/simulations/x/events", "GET, HEAD"),
        ("/v1/simulations/x/artifacts/volume.dcm", "GET, HEAD"),
        ("/v1/presets", "GET, HEAD"),
        ("/livez", "GET, HEAD"),
    ],
)
def test_allow_names_every_method(client, is_problem, path, allowed):
    response = client.put(path)
    is_problem(response, 405, "method-not-allowed")
    assert response.headers["allow"] == allowed


def test_unknown_path(client, is_problem):
    is_problem(client.get("/v2/nothing"), 404, "not-found")


def test_an_unexpected_error_tells_no_secrets(settings, broker, served, is_problem, monkeypatch):
    from fastapi.testclient import TestClient

    from api.app import create_app
    from worker.records.jobs import Jobs

    def broken(*_):
        raise RuntimeError("password")

    monkeypatch.setattr(Jobs, "page", broken)
    with TestClient(
        create_app(settings, broker, sweep=False),
        base_url="http://127.0.0.1",
        raise_server_exceptions=False,
        client=("127.0.0.1", 50000),
    ) as client:
        problem = is_problem(client.get("/v1/simulations"), 500, "internal-error")
    assert "password" not in json.dumps(problem)


class TestOtherSites:
    """Requests that a page of another site could make a browser send."""

    def test_a_name_that_points_to_loopback(self, client, is_problem):
        response = client.get("/v1/simulations", headers={"Host": "attacker.example"})
        is_problem(response, 403, "host-not-allowed")

    @pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "[::1]:8080"])
    def test_our_own_names(self, client, host):
        assert client.get("/v1/presets", headers={"Host": host}).status_code == 200

    def test_a_foreign_form(self, client, post, is_problem):
        path = post()["links"]["cancel"]
        response = client.post(path, headers={"Origin": "https://attacker.example"})
        is_problem(response, 403, "cross-origin")
        assert client.post(path, headers={"Origin": "http://127.0.0.1"}).status_code == 202

    def test_any_name_in_a_trusted_network(self, settings, broker):
        from fastapi.testclient import TestClient

        from api.app import create_app

        open_settings = settings.model_copy(update={"trusted_network": True})
        with TestClient(create_app(open_settings, broker, sweep=False), base_url="http://tomosim.lan") as client:
            assert client.get("/v1/presets").status_code == 200
