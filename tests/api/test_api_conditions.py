"""If-Match: who read something and changes it by what was read, changes nothing else (RFC 9110, section 13.1.1)."""

import pytest

PACS = {"name": "pacs", "host": "127.0.0.1", "port": 104, "called_aet": "PACS"}
STUDY = {"axes": [{"kind": "grid", "field": "seed", "values": [1]}]}
OTHERS = ['"other"', 'W/"other"', "", "nonsense", '"a", W/"b"']


@pytest.fixture(params=["simulation", "study", "destination", "webhook"])
def resource(request, client, post, finish, served):
    """Something that can be deleted: its path."""
    if request.param == "simulation":
        case = post()
        finish(case["id"])
        return case["links"]["self"]
    if request.param == "study":
        study = client.post("/v1/studies", json=STUDY).json()
        for case in served.studies.cases(study["id"]):
            finish(case.id)
        return study["links"]["self"]
    bodies = {"destination": PACS, "webhook": {"url": "https://93.184.216.34/hook"}}
    answer = client.post(f"/v1/{request.param}s", json=bodies[request.param])
    assert answer.status_code == 201
    return answer.json()["links"]["self"]


def test_what_can_be_deleted_has_a_strong_tag(client, resource):
    answer = client.get(resource)
    tag = answer.headers["etag"]
    assert tag.startswith('"')
    assert client.get(resource).content == answer.content
    for header in (tag, f"W/{tag}", f'"x", {tag}', "*"):
        same = client.get(resource, headers={"If-None-Match": header})
        assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", tag)
    assert client.get(resource, headers={"If-None-Match": '"x"'}).status_code == 200


@pytest.mark.parametrize("header", OTHERS)
def test_another_tag_deletes_nothing(client, resource, is_problem, header):
    tag = client.get(resource).headers["etag"]
    detail = is_problem(client.delete(resource, headers={"If-Match": header}), 412, "changed-meanwhile")["detail"]
    assert tag in detail
    # A weak tag never matches, not even its own (RFC 9110, section 8.8.3.2).
    is_problem(client.delete(resource, headers={"If-Match": f"W/{tag}"}), 412, "changed-meanwhile")
    assert client.get(resource).headers["etag"] == tag


@pytest.mark.parametrize("header", ["{tag}", '"a", {tag}', "*", "  * "])
def test_the_tag_that_was_read_deletes(client, resource, header):
    tag = client.get(resource).headers["etag"]
    assert client.delete(resource, headers={"If-Match": header.format(tag=tag)}).status_code == 204
    assert client.get(resource).status_code == 404
    assert client.delete(resource, headers={"If-Match": "*"}).status_code == 404


def test_a_change_changes_the_tag(client, post, finish, is_problem):
    case = post()
    path = case["links"]["self"]
    finish(case["id"])
    before = client.get(path).headers["etag"]
    client.post(f"{path}/pin")
    is_problem(client.delete(path, headers={"If-Match": before}), 412, "changed-meanwhile")


def test_while_it_runs_it_has_a_weak_tag_alone(client, post, served, is_problem):
    case = post()
    path = case["links"]["self"]
    assert served.jobs.claim(case["id"], "test")
    tag = client.get(path).headers["etag"]
    assert tag.startswith('W/"')
    assert "weak" in is_problem(client.delete(path, headers={"If-Match": tag}), 412, "changed-meanwhile")["detail"]
    is_problem(client.delete(path, headers={"If-Match": "*"}), 409, "not-finished")


@pytest.mark.parametrize(
    ("header", "status"), [('"1"', 200), ('"x", "1"', 200), ("*", 200), ('W/"1"', 412), ("1", 412)]
)
def test_changes_of_a_destination(client, header, status):
    path = client.post("/v1/destinations", json=PACS).json()["links"]["self"]
    assert client.patch(path, json={"port": 105}, headers={"If-Match": header}).status_code == status
    assert client.get(path).json()["port"] == (105 if status == 200 else 104)


def test_two_who_read_the_same_destination(client, served, monkeypatch, is_problem):
    """The tag was right when it was compared; the change that came in between is not lost."""
    path = client.post("/v1/destinations", json=PACS).json()["links"]["self"]
    delete = type(served.destinations).delete

    def changed_before(self, identifier, revision=None):
        assert client.patch(path, json={"port": 105}).status_code == 200
        return delete(self, identifier, revision)

    monkeypatch.setattr(type(served.destinations), "delete", changed_before)
    is_problem(client.delete(path, headers={"If-Match": '"1"'}), 412, "changed-meanwhile")
    assert client.get(path).json()["port"] == 105


@pytest.mark.parametrize(
    ("header", "status"), [(None, 206), ("{tag}", 206), ("*", 206), ('"other"', 412), ("W/{tag}", 412)]
)
def test_a_range_of_the_file_that_was_begun(client, done, header, status):
    path = f"{done}/artifacts/volume.dcm"
    tag = client.get(path).headers["etag"]
    headers = {"Range": "bytes=0-5"} | ({} if header is None else {"If-Match": header.format(tag=tag)})
    assert client.get(path, headers=headers).status_code == status
