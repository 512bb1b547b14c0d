"""Retention and pins over HTTP."""

import csv
import io
import json
import time
import zipfile

import pytest
import sqlalchemy as sa

from worker.records.database import simulations


@pytest.fixture
def expire(served):
    """The time of all cases that have one has passed."""

    def now():
        with served.jobs.engine.begin() as connection:
            ends = simulations.update().where(simulations.c.expires_at.is_not(None))
            connection.execute(ends.values(expires_at=time.time() - 1))

    return now


def test_files_are_given_out_until_they_expire(client, finish, expire, is_problem):
    case = client.post("/v1/simulations?retention_seconds=3600", json={"seed": 1}).json()
    assert (case["expires_at"], case["pinned"]) == (None, False)
    finish(case["id"])
    path = case["links"]["self"]
    tag = client.get(path).headers["etag"]
    assert client.get(path).json()["expires_at"] is not None
    assert client.get(f"{path}/artifacts/volume.dcm").status_code == 200
    expire()
    for name in ("artifacts", "artifacts/volume.dcm", "archive", "manifest"):
        assert "post it again" in is_problem(client.get(f"{path}/{name}"), 410, "expired")["detail"]
    assert client.get(path).json()["state"] == "succeeded"
    assert client.get(path).headers["etag"] != tag
    is_problem(client.post(f"{path}/pin"), 410, "expired")


def test_a_pinned_case_does_not_expire(client, finish, expire):
    case = client.post("/v1/simulations?retention_seconds=3600", json={"seed": 1}).json()
    path = case["links"]["self"]
    finish(case["id"])
    assert client.post(f"{path}/pin").json()["pinned"] is True
    expire()
    assert client.get(f"{path}/archive").status_code == 200
    freed = client.delete(f"{path}/pin").json()
    assert freed["pinned"] is False
    assert client.get(f"{path}/archive").status_code == 200  # from now on it is kept for an hour


def test_the_default_is_that_of_the_service(settings, broker):
    from fastapi.testclient import TestClient

    from api.app import create_app

    changed = settings.model_copy(update={"retention_seconds": 60.0})
    app = create_app(changed, broker, sweep=False)
    with TestClient(app, base_url="http://127.0.0.1", client=("127.0.0.1", 50000)) as client:
        for query, kept in (("", 60.0), ("?retention_seconds=0", None), ("?retention_seconds=5.5", 5.5)):
            case = client.post(f"/v1/simulations{query}", json={}).json()
            with app.state.services.jobs.engine.connect() as connection:
                column = sa.select(simulations.c.retention).where(simulations.c.id == case["id"])
                assert connection.scalar(column) == kept


def test_a_study_is_pinned_as_a_whole(client, served, finish, expire, is_problem):
    document = {"axes": [{"kind": "grid", "field": "seed", "values": [1, 2]}]}
    study = client.post("/v1/studies?retention_seconds=60", json=document).json()
    cases = served.studies.cases(study["id"], 10)
    for case in cases:
        finish(case.id)
    assert client.post(f"/v1/studies/{study['id']}/pin").status_code == 200
    expire()
    assert client.get(f"/v1/simulations/{cases[0].id}/archive").status_code == 200
    assert client.delete(f"/v1/studies/{study['id']}/pin").status_code == 200
    expire()
    is_problem(client.get(f"/v1/simulations/{cases[0].id}/archive"), 410, "expired")
    is_problem(client.post(f"/v1/studies/{study['id']}/pin"), 410, "expired")
    is_problem(client.post(f"/v1/studies/{'0' * 32}/pin"), 404, "study-not-found")


def test_a_study_of_which_some_cases_have_expired(client, served, finish, expire, is_problem):
    """What a case alone does not give out any more, its study does not either, and says so."""
    document = {"axes": [{"kind": "grid", "field": "seed", "values": [1, 2]}]}
    study = client.post("/v1/studies?retention_seconds=60", json=document).json()["links"]
    first, second = served.studies.cases(client.get(study["self"]).json()["id"], 10)
    finish(first.id)
    finish(second.id)
    assert client.post(f"/v1/simulations/{first.id}/pin").status_code == 200
    expire()
    is_problem(client.get(f"/v1/simulations/{second.id}/archive"), 410, "expired")

    kept, gone = client.get(study["manifest"]).json()["cases"]
    assert (kept["state"], kept["expired"], gone["state"], gone["expired"]) == ("succeeded", False, "succeeded", True)
    assert set(kept["files"]) >= {"volume.dcm"}
    assert "files" not in gone
    assert "stages" not in gone
    assert gone["results"]["volume_ml"] == 700.0
    assert [c["expired"] for c in client.get(study["cases"]).json()["items"]] == [False, True]
    table = list(csv.DictReader(io.StringIO(client.get(f"{study['manifest']}?format=csv").text)))
    assert [row["expired"] for row in table] == ["false", "true"]
    with zipfile.ZipFile(io.BytesIO(client.get(f"{study['self']}/archive").content)) as archive:
        assert archive.testzip() is None
        names = archive.namelist()
        assert "case-0001/volume.dcm" in names
        assert not [name for name in names if name.startswith("case-0002")]
        assert archive.read("missing.txt").decode() == "case-0002/\n"
        assert [c["expired"] for c in json.loads(archive.read("manifest.json"))["cases"]] == [False, True]

    assert client.delete(f"/v1/simulations/{first.id}/pin").status_code == 200
    expire()
    detail = is_problem(client.get(f"{study['self']}/archive"), 410, "expired")["detail"]
    assert "post it again" in detail


@pytest.mark.parametrize("wrong", ["-1", "soon", "1e11"])
def test_a_wrong_retention_is_refused(client, is_problem, wrong):
    is_problem(client.post(f"/v1/simulations?retention_seconds={wrong}", json={}), 422, "invalid-request")


def test_pins_of_nothing(client, is_problem):
    is_problem(client.post(f"/v1/simulations/{'0' * 32}/pin"), 404, "simulation-not-found")
    is_problem(client.delete("/v1/simulations/nonsense/pin"), 404, "simulation-not-found")
