"""Cases that come, share a study, expire, are deleted, or whose files are gone."""

from dataclasses import asdict

from simcore.core.errors import StoreError
from worker.records.database import simulations

VOLUME = "tomosynthesis.dcm"
LABELS = "labels.dcm"


def test_two_cases_with_the_same_study(client, add_case, exported, served):
    first, second = add_case(exported(seed=7), "first"), add_case(exported(seed=7), "second")
    params = {"StudyInstanceUID": first.study}
    between = add_case(exported(seed=5, laterality="R"), "between")
    third = add_case(exported(seed=7), "third")
    newest = [item["0020000D"]["Value"][0] for item in client.get("/dicomweb/studies?limit=2").json()]
    assert newest == [first.study, between.study]
    served.jobs.delete(between.id)
    for case in (third, second, first):
        (study,) = client.get("/dicomweb/studies", params=params).json()
        assert study["00201208"]["Value"] == [len(first.datasets)]
        assert len(client.get("/dicomweb/instances", params=params).json()) == len(first.datasets)
        assert client.get(first.url(VOLUME), headers={"Accept": "application/dicom"}).status_code == 200
        served.jobs.delete(case.id)  # the other one shows now
    assert client.get("/dicomweb/studies", params=params).json() == []
    assert client.get("/dicomweb/instances", params=params).json() == []
    assert client.get(first.url(VOLUME)).status_code == 404


def test_a_case_whose_files_are_gone(client, add_case, exported, served, is_problem, lose):
    case = add_case(exported(seed=8), "gone")
    client.get("/dicomweb/studies")
    manifest = served.jobs.manifest(case.id)
    sha256 = manifest["files"][VOLUME]["sha256"]
    lose(served.store, sha256)
    for what in ("", "/metadata", "/frames/1", "/rendered", "/thumbnail", "/bulkdata/7FE00010"):
        is_problem(client.get(case.url(VOLUME) + what), 410, "expired")
    is_problem(client.get(f"/dicomweb/studies/{case.study}"), 410, "expired")
    assert client.get(f"{case.url(LABELS)}/metadata").status_code == 200
    served.jobs.delete(case.id)


def test_a_case_that_has_expired(client, add_case, exported, served, is_problem):
    def expire(case):
        with served.jobs.engine.begin() as connection:
            connection.execute(simulations.update().where(simulations.c.id == case.id).values(expires_at=1.0))

    first, second = add_case(exported(seed=9), "first"), add_case(exported(seed=9), "second")
    params = {"StudyInstanceUID": first.study}
    assert len(client.get("/dicomweb/studies", params=params).json()) == 1
    expire(second)
    assert len(client.get("/dicomweb/studies", params=params).json()) == 1  # of the first one
    assert client.get(f"{first.url(VOLUME)}/metadata").status_code == 200
    expire(first)
    assert client.get("/dicomweb/studies", params=params).json() == []
    assert client.get("/dicomweb/instances", params=params).json() == []
    is_problem(client.get(f"{first.url(VOLUME)}/metadata"), 410, "expired")
    is_problem(client.get(f"/dicomweb/studies/{first.study}"), 410, "expired")
    third = add_case(exported(seed=9), "third")  # posted again: found without a search before
    assert client.get(f"{first.url(VOLUME)}/metadata").status_code == 200
    for case in (first, second, third):
        served.jobs.delete(case.id)


def test_the_store_does_not_answer(client, case, add_case, exported, served, monkeypatch):
    client.get("/dicomweb/studies")  # the index knows the first case now
    late = add_case(exported(seed=10), "late")

    def refuse(*_):
        raise StoreError("the bucket does not answer")

    with monkeypatch.context() as patch:
        patch.setattr(type(served.store), "stream", refuse)
        known = [item["0020000D"]["Value"][0] for item in client.get("/dicomweb/studies").json()]
    assert case.study in known
    assert late.study not in known
    assert len(client.get("/dicomweb/studies", params={"StudyInstanceUID": late.study}).json()) == 1
    served.jobs.delete(late.id)


def test_files_that_are_no_dicom(client, served, tmp_path):
    (tmp_path / "broken.dcm").write_bytes(b"\0" * 128 + b"DICM" + b"nonsense" * 40)
    (tmp_path / "text.dcm").write_text("text")
    posted = client.post("/v1/simulations", json={"name": "broken"}).json()
    files = {path.name: asdict(served.store.add(path)) for path in list(tmp_path.iterdir())}
    assert served.jobs.claim(posted["id"], "test")
    served.jobs.succeed(posted["id"], "test", {"files": files, "stages": []})
    before = len(client.get("/dicomweb/studies").json())
    assert len(client.get("/dicomweb/studies").json()) == before
    assert client.app.state.dicom_indexer.index.missing() is None
