"""/v1/studies: the life of a study as a client sees it."""

import csv
import io
import json
import time
import zipfile

import pytest

from worker.records.jobs import StageProgress

ERROR = {"kind": "simulation", "code": "solver-failed", "message": '=HYPERLINK("http://evil","use less")'}
PAIRS = {
    "name": "pairs",
    "axes": [
        {"kind": "grid", "field": "compression.percent", "values": [20.0, 30.0, 40.0]},
        {"kind": "lesion_pair", "lesions": [{"kind": "mass"}]},
    ],
}


@pytest.fixture
def study(client):
    response = client.post("/v1/studies", json=PAIRS)
    assert response.status_code == 202, response.text
    return response.json()


@pytest.fixture
def cases(client, study):
    return client.get(study["links"]["cases"]).json()["items"]


def fail(served, case):
    assert served.jobs.claim(case["id"], "test")
    assert served.jobs.fail(case["id"], "test", ERROR)


def test_a_study_is_queued_whole(client, broker, served):
    response = client.post("/v1/studies", json=PAIRS)
    body = response.json()
    assert response.headers["location"] == f"http://127.0.0.1/v1/studies/{body['id']}"
    assert int(response.headers["retry-after"]) >= 1
    assert (body["state"], body["cases"], body["finished_cases"]) == ("queued", 6, 0)
    assert body["counts"] == {"queued": 6, "running": 0, "cancelling": 0, "succeeded": 0, "failed": 0, "cancelled": 0}
    assert body["columns"] == ["compression.percent", "lesions"]
    assert body["study"]["axes"][0]["values"] == [20.0, 30.0, 40.0]
    assert body["estimate"]["cases"] == 6
    cases = client.get(body["links"]["cases"]).json()["items"]
    assert [c["number"] for c in cases] == [1, 2, 3, 4, 5, 6]
    assert cases[1]["coordinates"] == {"compression.percent": 20.0, "lesions": "present"}
    assert cases[1]["name"] == "pairs 0002"
    # Cases of a study do not stand in the way of others.
    assert broker.messages == [(c["id"], "batch") for c in cases]
    specification = client.get(cases[5]["href"]).json()
    assert specification["specification"]["compression"]["percent"] == 40.0
    assert specification["study"] == {"id": body["id"], "number": 6, "coordinates": cases[5]["coordinates"]}
    assert specification["links"]["study"] == body["links"]["self"]


def test_the_sweep_sends_what_does_not_go_out_at_once(client, broker, served):
    axes = [{"kind": "random", "count": 30, "draws": {"seed": {"kind": "integer"}}}]
    study = client.post("/v1/studies", json={"axes": axes}).json()
    cases = client.get(study["links"]["cases"]).json()["items"]
    assert [identifier for identifier, _ in broker.messages] == [c["id"] for c in cases[:10]]
    assert [row.id for row in served.jobs.unsent()] == [c["id"] for c in cases[10:]]


def test_a_broker_that_is_down_refuses_nothing(client, broker, served):
    broker.down = True
    assert client.post("/v1/studies", json=PAIRS).status_code == 202
    assert len(served.jobs.unsent()) == 6


def test_estimate_keeps_nothing(client, broker):
    needs = client.post("/v1/studies/estimate", json=PAIRS).json()
    one = client.post("/v1/simulations/estimate", json={"compression": {"percent": 20.0}}).json()
    assert needs["cases"] == 6
    assert needs["output_bytes"] > 5 * one["output_bytes"]
    assert needs["memory_bytes"] >= one["memory_bytes"]
    assert client.get("/v1/studies").json() == {"items": [], "next": None}
    assert client.get("/v1/simulations").json()["items"] == []
    assert broker.messages == []


class TestRefusals:
    def refused(self, client, is_problem, body, code="invalid-request"):
        problem = is_problem(client.post("/v1/studies", json=body), 422, code)
        assert client.get("/v1/studies").json()["items"] == []
        assert client.get("/v1/simulations").json()["items"] == []
        return problem

    def test_the_case_and_the_field_are_named(self, client, is_problem):
        axes = [
            {"kind": "grid", "field": "seed", "values": [1, 2]},
            {"kind": "grid", "field": "acquisition.views", "values": [7, 1, 15]},
        ]
        problem = self.refused(client, is_problem, {"axes": axes, "base": {"phantom": {"colour": "red"}}})
        assert problem["detail"].startswith("6 cases cannot be simulated: case 1 and 5 more: phantom.colour = 'red'")
        (base,) = problem["errors"]
        assert (base["pointer"], base["case"], base["cases"]) == ("/base/phantom/colour", 1, 6)
        problem = self.refused(client, is_problem, {"axes": axes})
        (entry,) = problem["errors"]
        assert (entry["pointer"], entry["value"], entry["case"], entry["cases"]) == ("/axes/1/values/1", 1, 2, 2)
        assert entry["coordinates"] == {"seed": 1, "acquisition.views": 1}
        assert "case 2 and 1 more: acquisition.views = 1: a volume needs at least 2 views" in problem["detail"]

    def test_a_wrong_axis(self, client, is_problem):
        axes = [{"kind": "random", "count": 2, "draws": {"phantom.skin_mm": {"kind": "uniform", "low": 2, "high": 1}}}]
        problem = self.refused(client, is_problem, {"axes": axes})
        assert problem["errors"][0]["pointer"] == "/axes/0/draws/phantom.skin_mm"

    def test_a_way_that_leads_nowhere(self, client, is_problem):
        axes = [{"kind": "grid", "field": "/seed/low", "values": [1]}]
        problem = self.refused(client, is_problem, {"base": {"seed": 3}, "axes": axes})
        assert problem["errors"][0]["pointer"] == "/axes/0/values/0"

    def test_too_costly(self, client, is_problem):
        axes = [{"kind": "grid", "field": "phantom.voxel_mm", "values": [0.2, 0.05]}]
        problem = self.refused(client, is_problem, {"axes": axes}, "resource-limit")
        assert problem["errors"][0]["case"] == 2
        assert "8.0 GB are allowed" in problem["detail"]

    def test_too_many_cases(self, client, is_problem):
        draws = {"seed": {"kind": "integer"}}
        axes = [{"kind": "random", "count": 1001, "draws": draws}, PAIRS["axes"][1]]
        problem = self.refused(client, is_problem, {"axes": axes}, "study-too-large")
        assert "2002 cases (1001 x 2), and 2000 are allowed" in problem["detail"]
        assert (problem["cases"], problem["allowed"]) == (2002, 2000)

    def test_a_full_disk(self, client, served, is_problem):
        served.store.workspaces.min_free_bytes = 1 << 60
        is_problem(client.post("/v1/studies", json=PAIRS), 507, "storage-full")
        assert client.get("/v1/studies").json()["items"] == []

    @pytest.mark.parametrize("body", [b"{", b"[]", b"null", b'{"axes": [{"kind": "grid", "field": "seed"}]}'])
    def test_what_is_no_study(self, client, is_problem, body):
        response = client.post("/v1/studies", content=body, headers={"Content-Type": "application/json"})
        assert is_problem(response, 422, "invalid-request")["errors"]

    def test_not_json(self, client, is_problem):
        response = client.post("/v1/studies", content=b"{}", headers={"Content-Type": "text/plain"})
        is_problem(response, 415, "unsupported-media-type")

    @pytest.mark.parametrize("path", ["", "/cases", "/manifest", "/archive", "/events"])
    def test_no_such_study(self, client, is_problem, path):
        for identifier in ("0" * 32, "nonsense"):
            is_problem(client.get(f"/v1/studies/{identifier}{path}"), 404, "study-not-found")

    @pytest.mark.parametrize("action", ["cancel", "retry"])
    def test_nothing_to_change(self, client, is_problem, action):
        is_problem(client.post(f"/v1/studies/{'0' * 32}/{action}"), 404, "study-not-found")


def test_states_follow_from_the_cases(client, study, cases, served, finish):
    def state():
        return client.get(study["links"]["self"]).json()["state"]

    served.jobs.claim(cases[0]["id"], "test")
    assert state() == "running"
    served.jobs.fail(cases[0]["id"], "test", ERROR)
    assert state() == "running"
    for case in cases[1:]:
        finish(case["id"])
    body = client.get(study["links"]["self"]).json()
    assert (body["state"], body["finished_cases"]) == ("partial", 6)
    assert body["counts"]["succeeded"] == 5
    assert body["finished_at"] >= body["started_at"]
    assert {"retry", "archive"} <= set(body["links"])
    assert "cancel" not in body["links"]
    client.post(study["links"]["self"] + "/retry")
    finish(cases[0]["id"])
    assert state() == "succeeded"


def test_entity_tag_follows_the_counts(client, study, cases, served):
    path = study["links"]["self"]
    tag = client.get(path).headers["etag"]
    same = client.get(path, headers={"If-None-Match": tag})
    assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", tag)
    assert "retry-after" in same.headers
    served.jobs.claim(cases[0]["id"], "test")
    assert client.get(path, headers={"If-None-Match": tag}).status_code == 200


def test_cancel(client, study, cases, served, finish, is_problem):
    finish(cases[0]["id"])
    served.jobs.claim(cases[1]["id"], "test")
    body = client.post(study["links"]["self"] + "/cancel").json()
    assert body["state"] == "cancelling"
    assert (body["counts"]["cancelled"], body["counts"]["cancelling"]) == (4, 1)
    kinds = [e.data["state"] for e in served.jobs.events_after(cases[2]["id"], 0)]
    assert kinds == ["queued", "cancelled"]
    assert served.jobs.cancelled(cases[1]["id"], "test")
    assert client.get(study["links"]["self"]).json()["state"] == "partial"
    is_problem(client.post(study["links"]["self"] + "/cancel"), 409, "already-finished")


def test_retry_takes_the_failed_cases_alone(client, study, cases, served, broker, is_problem):
    is_problem(client.post(study["links"]["self"] + "/retry"), 409, "nothing-to-retry")
    fail(served, cases[0])
    fail(served, cases[1])
    client.post(f"{cases[2]['href']}/cancel")
    broker.messages.clear()
    body = client.post(study["links"]["self"] + "/retry").json()
    assert (body["counts"]["queued"], body["counts"]["failed"], body["counts"]["cancelled"]) == (5, 0, 1)
    assert [identifier for identifier, _ in broker.messages] == [cases[0]["id"], cases[1]["id"]]
    again = client.get(cases[0]["href"]).json()
    assert (again["state"], again["attempt"], again["error"]) == ("queued", 0, None)
    body = client.post(study["links"]["self"] + "/retry?cancelled=true").json()
    assert body["counts"]["queued"] == 6


def test_delete_when_it_has_ended(client, study, cases, served, is_problem):
    is_problem(client.delete(study["links"]["self"]), 409, "not-finished")
    is_problem(client.delete(cases[0]["href"]), 409, "part-of-study")
    client.post(study["links"]["self"] + "/cancel")
    assert client.delete(study["links"]["self"]).status_code == 204
    is_problem(client.get(study["links"]["self"]), 404, "study-not-found")
    is_problem(client.get(cases[0]["href"]), 404, "simulation-not-found")
    assert served.jobs.events_after(cases[0]["id"], 0) == []


def test_pages(client):
    for number in range(3):
        client.post("/v1/studies", json={**PAIRS, "name": str(number)})
    first = client.get("/v1/studies?limit=2")
    assert [s["name"] for s in first.json()["items"]] == ["2", "1"]
    second = client.get(first.links["next"]["url"])
    assert [s["name"] for s in second.json()["items"]] == ["0"]
    assert "link" not in second.headers
    assert "study" not in {k for s in first.json()["items"] for k, v in s.items() if v is not None}


def test_pages_of_cases(client, study, cases, is_problem):
    path = study["links"]["cases"]
    first = client.get(f"{path}?limit=4")
    assert [c["number"] for c in first.json()["items"]] == [1, 2, 3, 4]
    second = client.get(first.links["next"]["url"])
    assert [c["number"] for c in second.json()["items"]] == [5, 6]
    client.post(f"{cases[4]['href']}/cancel")
    assert [c["number"] for c in client.get(f"{path}?state=cancelled").json()["items"]] == [5]
    is_problem(client.get(f"{path}?cursor=nonsense"), 400, "bad-cursor")


def test_simulations_of_a_study(client, study, post, is_problem):
    post(name="alone")
    listed = client.get(study["links"]["simulations"]).json()["items"]
    assert [s["study"]["number"] for s in listed] == [6, 5, 4, 3, 2, 1]
    assert len(client.get("/v1/simulations").json()["items"]) == 7
    is_problem(client.get("/v1/simulations?study_id=nonsense"), 422, "invalid-request")


def test_manifest(client, study, cases, served, finish):
    fail(served, cases[0])
    finish(cases[1]["id"])
    body = client.get(study["links"]["manifest"]).json()
    assert body["schema"] == "tomosim-study-manifest/1"
    assert body["study"]["study"]["axes"] == study["study"]["axes"]
    failed, done, queued = body["cases"][:3]
    assert (failed["state"], failed["error"]["code"]) == ("failed", "solver-failed")
    assert "files" not in failed
    assert (done["folder"], done["coordinates"]["lesions"]) == ("case-0002", "present")
    assert len(done["files"]["volume.dcm"]["sha256"]) == 64
    assert [stage["name"] for stage in done["stages"]] == ["dicom", "preview"]
    assert queued["state"] == "queued"


@pytest.mark.parametrize(
    ("query", "accept", "kind"),
    [
        ("?format=csv", None, "text/csv"),
        ("?format=json", "text/csv", "application/json"),
        ("", "text/csv", "text/csv"),
        ("", "application/json;q=0.5, text/csv;q=0.8", "text/csv"),
        ("", "text/csv;q=0.5, application/json", "application/json"),
        ("", "*/*", "application/json"),
        ("", "text/csv;q=nonsense", "application/json"),
    ],
)
def test_the_format_of_the_manifest(client, study, query, accept, kind):
    headers = {} if accept is None else {"Accept": accept}
    response = client.get(study["links"]["manifest"] + query, headers=headers)
    assert response.headers["content-type"].startswith(kind)


def test_the_table(client, study, cases, served, finish):
    fail(served, cases[0])
    finish(cases[1]["id"])
    text = client.get(study["links"]["manifest"] + "?format=csv").text
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 6
    assert rows[1]["compression.percent"] == "20.0"
    assert (rows[1]["lesions"], rows[1]["state"], rows[1]["volume_ml"]) == ("present", "succeeded", "700.0")
    assert (rows[0]["error_code"], rows[0]["volume_ml"]) == ("solver-failed", "")
    assert rows[0]["error"] == "'" + ERROR["message"]


def test_no_cell_is_a_formula(client):
    axes = [
        {"kind": "grid", "field": "name", "values": ["=1+1", "+1", "-1", "@a", "fine"]},
        {"kind": "grid", "field": "seed", "values": [1], "name": "=cmd", "labels": ["-label"]},
        {"kind": "grid", "field": "acquisition.views", "values": [7]},
    ]
    study = client.post("/v1/studies", json={"axes": axes}).json()
    rows = list(csv.reader(io.StringIO(client.get(study["links"]["manifest"] + "?format=csv").text)))
    assert "'=cmd" in rows[0]
    assert [row[1] for row in rows[1:]] == ["'=1+1", "'+1", "'-1", "'@a", "fine"]
    assert {row[rows[0].index("'=cmd")] for row in rows[1:]} == {"'-label"}
    assert not any(cell.startswith(("=", "+", "-", "@")) for row in rows for cell in row)


def test_archive(client, study, cases, served, finish, is_problem):
    is_problem(client.get(study["links"]["self"] + "/archive"), 409, "not-finished")
    fail(served, cases[0])
    finish(cases[1]["id"])
    finish(cases[4]["id"])
    response = client.get(study["links"]["self"] + "/archive")
    assert f'study-{study["id"]}.zip"' in response.headers["content-disposition"]
    with zipfile.ZipFile(io.BytesIO(response.content)) as archive:
        names = archive.namelist()
        assert archive.testzip() is None
        assert names[:2] == ["manifest.json", "manifest.csv"]
        assert {name.split("/")[0] for name in names[2:]} == {"case-0002", "case-0005"}
        one = client.get(f"{cases[1]['href']}/artifacts/volume.dcm").content
        assert archive.read("case-0002/volume.dcm") == one
        assert json.loads(archive.read("case-0005/manifest.json"))["files"]
    with zipfile.ZipFile(io.BytesIO(client.get(study["links"]["self"] + "/archive?only=preview").content)) as archive:
        assert "case-0002/preview/phantom.png" in archive.namelist()
        assert "case-0002/volume.dcm" not in archive.namelist()


def test_archive_of_a_study_some_of_whose_files_have_expired(client, study, cases, served, finish):
    finish(cases[1]["id"])
    gone = client.get(f"{cases[1]['href']}/artifacts").json()["items"][0]
    assert served.store.remove_object(gone["sha256"], unused_since=time.time() + 60)
    with zipfile.ZipFile(io.BytesIO(client.get(study["links"]["self"] + "/archive").content)) as archive:
        assert archive.testzip() is None
        assert archive.read("missing.txt").decode() == f"case-0002/{gone['name']}\n"
        assert "case-0002/volume.dcm" in archive.namelist()
        assert f"case-0002/{gone['name']}" not in archive.namelist()


def test_events(client, study, cases, served, finish):
    for case in cases[:5]:
        finish(case["id"])
    served.jobs.claim(cases[5]["id"], "test")
    served.jobs.progress(cases[5]["id"], "test", StageProgress("mesh", 0, 2, 0.5, ""))
    with client.stream("GET", study["links"]["events"]) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        lines = stream.iter_lines()
        first = next(json.loads(line[6:]) for line in lines if line.startswith("data: "))
        assert (first["state"], first["finished_cases"]) == ("running", 5)
        fail_last = served.jobs.fail(cases[5]["id"], "test", ERROR)
        assert fail_last
        rest = [json.loads(line[6:]) for line in lines if line.startswith("data: ")]
    assert [e["state"] for e in rest] == ["partial"]
