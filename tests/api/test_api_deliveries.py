"""/v1/destinations and /v1/deliveries: made, changed, refused with words that help; who may do what."""

import socket
import threading
from dataclasses import asdict

import pytest
from fastapi.testclient import TestClient

from api.app import create_app
from tests.support import peers
from tests.support.dicom_files import TOMO, write_dicom
from worker.delivery.outcomes import of_status
from worker.delivery.sender import Sender

URL = "http://127.0.0.1"
PACS = {"name": "pacs", "host": "127.0.0.1", "port": 104, "called_aet": "PACS"}


@pytest.fixture
def make(client):
    def create(**more):
        response = client.post("/v1/destinations", json={**PACS, **more})
        assert response.status_code == 201, response.text
        return response.json()

    return create


@pytest.fixture
def case(served, post, tmp_path):
    """A case with two DICOM series that can be read, and something else."""
    row = post(name="real")
    files = {}
    for number, name in enumerate(("projections/0001.dcm", "projections/0002.dcm", "volume.dcm"), 1):
        more = {"sop_class": TOMO, "frames": 2} if name == "volume.dcm" else {}
        write_dicom(tmp_path / "a.dcm", number=number, **more)
        files[name] = asdict(served.store.add(tmp_path / "a.dcm"))
    (tmp_path / "a.png").write_bytes(b"png")
    files["preview/a.png"] = asdict(served.store.add(tmp_path / "a.png"))
    assert served.jobs.claim(row["id"], "test")
    assert served.jobs.succeed(row["id"], "test", {"files": files, "results": {}})
    return row["id"]


def deliver(served, path):
    """Carries out a delivery here."""
    identifier = path.rsplit("/", 1)[-1]
    sender = Sender("test", served.settings, served.deliveries, served.store, threading.Event())
    sender.run(identifier)


def test_a_destination_from_first_to_last(client, make):
    row = make(limits={"associations": 2})
    path = row["links"]["self"]
    assert (row["calling_aet"], row["tls"], row["limits"]["associations"]) == ("TOMOSIM", None, 2)
    shown = client.get(path)
    assert shown.json() == row
    assert shown.headers["etag"] == '"1"'
    changed = client.patch(path, json={"port": 11112, "limits": {"attempts": 3}, "tls": {"ca_file": "ca.pem"}}).json()
    assert (changed["port"], changed["revision"]) == (11112, 2)
    assert (changed["limits"]["associations"], changed["limits"]["attempts"]) == (2, 3)
    assert changed["tls"]["verify"] is True
    back = client.patch(path, json={"tls": None, "limits": None}, headers={"If-Match": '"2"'}).json()
    assert (back["tls"], back["limits"]["associations"]) == (None, 1)
    assert [d["name"] for d in client.get("/v1/destinations").json()["items"]] == ["pacs"]
    assert client.delete(path).status_code == 204
    assert client.get(path).status_code == 404


@pytest.mark.parametrize(
    ("change", "pointer", "words"),
    [
        ({"called_aet": "A" * 17}, "/called_aet", "1 to 16"),
        ({"called_aet": "A\\B"}, "/called_aet", "backslash"),
        ({"called_aet": " A"}, "/called_aet", "space"),
        ({"calling_aet": ""}, "/calling_aet", "1 to 16"),
        ({"port": 0}, "/port", "greater than or equal to 1"),
        ({"port": "104"}, "/port", "integer"),
        ({"host": "http://pacs"}, "/host", "without scheme"),
        ({"host": "pacs:104"}, "/host", "without scheme"),
        ({"name": "my pacs"}, "/name", "letters"),
        ({"name": "0" * 32}, "/name", "not an identifier"),
        ({"tls": {"ca_file": "../ca.pem"}}, "/tls/ca_file", "'..'"),
        ({"tls": {"key_file": "k.pem"}}, "/tls", "certificate_file"),
        ({"limits": {"bandwidth_MBps": 0}}, "/limits/bandwidth_MBps", "greater than"),
        ({"limits": {"associations": 100}}, "/limits/associations", "less than"),
        ({"transfer_syntaxes": ["jpeg"]}, "/transfer_syntaxes/0", "explicit"),
        ({"transfer_syntaxes": ["rle"]}, "", "explicit"),
        ({"aet": "X"}, "/aet", "not permitted"),
    ],
)
def test_a_wrong_destination_is_refused(client, make, is_problem, change, pointer, words):
    problem = is_problem(client.post("/v1/destinations", json={**PACS, **change}), 422, "invalid-request")
    assert problem["errors"][0]["pointer"] == pointer
    assert words in problem["errors"][0]["detail"]
    path = make()["links"]["self"]
    is_problem(client.patch(path, json=change), 422, "invalid-request")


def test_what_stands_in_the_way_of_a_change(client, make, is_problem, case):
    path = make()["links"]["self"]
    make(name="other")
    is_problem(client.post("/v1/destinations", json=PACS), 409, "name-taken")
    is_problem(client.patch(path, json={"name": "other"}), 409, "name-taken")
    is_problem(client.patch(path, json={"port": 1}, headers={"If-Match": '"7"'}), 412, "changed-meanwhile")
    is_problem(client.patch(path, json=[]), 422, "invalid-request")
    is_problem(client.patch(path, content=b"{", headers={"Content-Type": "application/json"}), 422, "invalid-request")
    is_problem(client.patch(path, content=b"{}", headers={"Content-Type": "text/plain"}), 415, "unsupported-media-type")
    delivery = client.post("/v1/deliveries", json={"destination": "pacs", "simulation_id": case}).json()
    is_problem(client.delete(path), 409, "destination-in-use")
    client.post(delivery["links"]["cancel"])
    assert client.delete(path).status_code == 204
    assert client.get(delivery["links"]["self"]).json()["destination"]["name"] == "pacs"
    for method, end in (("get", ""), ("patch", ""), ("delete", ""), ("post", "/echo")):
        more = {"json": {}} if method == "patch" else {}
        is_problem(getattr(client, method)(f"{path}{end}", **more), 404, "destination-not-found")
    is_problem(client.get("/v1/destinations/pacs"), 404, "destination-not-found")


def test_the_allow_list(settings, broker, is_problem):
    allowed = settings.load(data_folder=settings.data_folder, destination_hosts="10.1.0.0/16, *.example.org")
    with TestClient(create_app(allowed, broker, sweep=False), base_url=URL, client=("127.0.0.1", 50000)) as client:
        for host in ("10.2.0.1", "pacs.example.com"):
            response = client.post("/v1/destinations", json={**PACS, "host": host})
            if host == "pacs.example.com":
                assert response.status_code == 201  # its address will tell
                continue
            problem = is_problem(response, 422, "invalid-request")
            assert problem["reason"] == "destination-not-allowed"
            assert "10.1.0.0/16, *.example.org" in problem["detail"]
            assert "TOMOSIM_DESTINATION_HOSTS" in problem["detail"]
        for number, host in enumerate(("10.1.7.7", "pacs.example.org")):
            body = {**PACS, "host": host, "name": f"n{number}"}
            assert client.post("/v1/destinations", json=body).status_code == 201
        path = client.get("/v1/destinations").json()["items"][0]["links"]["self"]
        is_problem(client.patch(path, json={"host": "10.2.0.1"}), 422, "invalid-request")


def test_echo(client, make):
    peer = peers.Scp()
    try:
        answer = client.post(make(port=peer.port, called_aet="PEER")["links"]["echo"]).json()
    finally:
        peer.close()
    assert (answer["reachable"], answer["code"]) == (True, "ok")
    assert any("Digital Mammography" in name for name in answer["accepted"])
    assert any("CT Image Storage" in name for name in answer["refused"])
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    answer = client.post(make(name="closed", port=port)["links"]["echo"]).json()
    assert (answer["reachable"], answer["code"]) == (False, "connection-refused")
    assert str(port) in answer["message"]


def test_a_delivery_from_first_to_last(client, served, broker, make, case):
    peer = peers.Scp([0, 0xB000, 0xC000, 0])
    make(port=peer.port)
    response = client.post("/v1/deliveries", json={"destination": "pacs", "simulation_id": case})
    assert response.status_code == 202
    queued = response.json()
    path = queued["links"]["self"]
    assert response.headers["location"].endswith(path)
    assert broker.messages[-1] == (queued["id"], "delivery")
    assert (queued["state"], queued["instances_total"]) == ("queued", 3)
    assert [i["name"] for i in queued["instances"]] == ["projections/0001.dcm", "projections/0002.dcm", "volume.dcm"]
    deliver(served, path)
    shown = client.get(path)
    ended = shown.json()
    assert (ended["state"], ended["instances_stored"], ended["instances_failed"]) == ("failed", 2, 1)
    assert ended["error"]["code"] == "not-understood"
    assert [i["status"] for i in ended["instances"]] == ["0x0000", "0xB000", "0xC000"]
    assert ended["bytes_stored"] == sum(i["size"] for i in ended["instances"][:2])
    assert client.get(path, headers={"If-None-Match": shown.headers["etag"]}).status_code == 304
    assert client.post(ended["links"]["retry"]).status_code == 202
    deliver(served, path)
    peer.close()
    assert client.get(path).json()["state"] == "succeeded"
    assert len(peer.received) == 4
    events = client.get(f"{path}/events").text
    assert events.count("event: state") == 6
    assert '"instance_state": "stored"' in events
    assert f'"delivery": "{path}"' in events


def test_a_part_of_a_case(client, make, case, is_problem):
    make()

    def ask(**what):
        return client.post("/v1/deliveries", json={"destination": "pacs", "simulation_id": case, **what})

    assert [i["name"] for i in ask(files=["volume.dcm"]).json()["instances"]] == ["volume.dcm"]
    assert ask(files=["projections/*"]).json()["instances_total"] == 2
    assert [i["name"] for i in ask(series=["2.25.7.2"]).json()["instances"]] == ["volume.dcm"]
    problem = is_problem(ask(series=["2.25.7.2", "1.2.3"]), 422, "invalid-request")
    assert problem["errors"][0]["pointer"] == "/series/1"
    assert "2.25.7.1, 2.25.7.2" in problem["detail"]
    problem = is_problem(ask(files=["*.png"]), 422, "invalid-request")
    assert "projections/0001.dcm" in problem["detail"]
    is_problem(ask(files=["volume.dcm"], series=["2.25.7.2"]), 422, "invalid-request")
    is_problem(ask(destination="elsewhere"), 422, "invalid-request")
    is_problem(ask(simulation_id="0" * 32), 404, "simulation-not-found")
    is_problem(ask(simulation_id=None), 422, "invalid-request")


def test_a_case_that_cannot_be_sent(client, served, post, make, case, is_problem, lose):
    make()
    waiting = post(name="waits", seed=77)
    body = {"destination": "pacs", "simulation_id": waiting["id"]}
    is_problem(client.post("/v1/deliveries", json=body), 409, "not-finished")
    ref = served.jobs.manifest(case)["files"]["volume.dcm"]
    lose(served.store, ref["sha256"])
    body = {"destination": "pacs", "simulation_id": case}
    is_problem(client.post("/v1/deliveries", json=body), 410, "expired")
    for path in ("/v1/deliveries/x", f"/v1/deliveries/{'0' * 32}", f"/v1/deliveries/{'0' * 32}/instances"):
        is_problem(client.get(path), 404, "delivery-not-found")
    is_problem(client.post(f"/v1/deliveries/{'0' * 32}/retry"), 404, "delivery-not-found")


def test_the_same_request_twice(client, make, case):
    make()
    body = {"destination": "pacs", "simulation_id": case}
    first, second = (
        client.post("/v1/deliveries", json=body, headers={"Idempotency-Key": "once"}).json() for _ in range(2)
    )
    assert first["id"] == second["id"]
    assert len(client.get("/v1/deliveries").json()["items"]) == 1


def test_lists(client, make, case, is_problem):
    destination = make()
    body = {"destination": destination["id"], "simulation_id": case}
    identifiers = [client.post("/v1/deliveries", json=body).json()["id"] for _ in range(3)]
    client.post(f"/v1/deliveries/{identifiers[0]}/cancel")
    seen, url = [], "/v1/deliveries?limit=2"
    while url:
        response = client.get(url)
        seen += [d["id"] for d in response.json()["items"]]
        url = response.links.get("next", {}).get("url")
    assert seen == identifiers[::-1]
    for query, count in (
        ("state=cancelled", 1),
        (f"simulation_id={case}", 3),
        (f"simulation_id={'0' * 32}", 0),
        (f"destination_id={destination['id']}&state=queued", 2),
    ):
        assert len(client.get(f"/v1/deliveries?{query}").json()["items"]) == count
    is_problem(client.get("/v1/deliveries?cursor=x"), 400, "bad-cursor")
    page = client.get(f"/v1/deliveries/{identifiers[0]}/instances?limit=2").json()
    assert ([i["number"] for i in page["items"]], page["next"]) == ([0, 1], 1)
    page = client.get(f"/v1/deliveries/{identifiers[0]}/instances?limit=2&after=1").json()
    assert ([i["number"] for i in page["items"]], page["next"]) == ([2], None)


def test_states_that_allow_it(client, served, make, case, is_problem):
    make()
    delivery = client.post("/v1/deliveries", json={"destination": "pacs", "simulation_id": case}).json()
    path = delivery["links"]["self"]
    is_problem(client.post(f"{path}/retry"), 409, "not-finished")
    assert client.post(f"{path}/cancel").json()["state"] == "cancelled"
    assert client.post(f"{path}/retry").json()["state"] == "queued"
    row = served.deliveries.claim(delivery["id"], "w")
    for number in range(row.instances):
        served.deliveries.record(delivery["id"], number, of_status(0), 3)
    served.deliveries.succeed(delivery["id"], "w")
    is_problem(client.post(f"{path}/retry"), 409, "already-finished")
    is_problem(client.post(f"{path}/cancel"), 409, "already-finished")


def test_delivered_with_its_success(client, served, make, finish, is_problem):
    """Made in the transaction of the success, and no part of the specification."""
    destination = make()
    body = {"name": "fine", "seed": 3, "deliver": [{"destination": "pacs", "files": ["volume.dcm"]}]}
    posted = client.post("/v1/simulations", json=body).json()
    plain = client.post("/v1/simulations", json={"name": "fine", "seed": 3}).json()
    assert posted["specification"] == plain["specification"]
    assert client.get("/v1/deliveries").json()["items"] == []
    finish(posted["id"])
    finish(plain["id"])
    (delivery,) = client.get("/v1/deliveries").json()["items"]
    assert (delivery["simulation_id"], delivery["automatic"], delivery["state"]) == (posted["id"], True, "queued")
    assert delivery["destination"] == {"id": destination["id"], "name": "pacs"}
    assert [i.name for i in served.deliveries.instances(delivery["id"])] == ["volume.dcm"]
    assert [row.id for row in served.deliveries.unsent()] == [delivery["id"]]
    for deliver_field, pointer in (
        ([{"destination": "nowhere"}], "/deliver/0/destination"),
        ([{"to": "pacs"}], "/deliver/0/destination"),
        ("pacs", "/deliver"),
    ):
        problem = is_problem(
            client.post("/v1/simulations", json={**body, "deliver": deliver_field}), 422, "invalid-request"
        )
        assert problem["errors"][0]["pointer"] == pointer


def test_a_destination_that_was_removed_meanwhile(client, served, make, finish):
    path = make()["links"]["self"]
    posted = client.post("/v1/simulations", json={"deliver": [{"destination": "pacs"}]}).json()
    assert client.delete(path).status_code == 204
    finish(posted["id"])
    assert client.get(posted["links"]["self"]).json()["state"] == "succeeded"
    (delivery,) = client.get("/v1/deliveries").json()["items"]
    deliver(served, delivery["links"]["self"])
    ended = client.get(delivery["links"]["self"]).json()
    assert (ended["state"], ended["error"]["code"]) == ("failed", "destination-not-found")
    assert "'pacs' was removed" in ended["error"]["message"]


def test_a_failed_case_delivers_nothing(client, served, make):
    make()
    posted = client.post("/v1/simulations", json={"deliver": [{"destination": "pacs"}]}).json()
    served.jobs.claim(posted["id"], "w")
    served.jobs.fail(posted["id"], "w", {"kind": "system", "code": "x", "message": "x"})
    assert client.get("/v1/deliveries").json()["items"] == []


def test_scopes(client, served, make, case, is_problem):
    make()
    secrets = {
        scopes: served.keys.create("k", list(scopes))[1] for scopes in (("read",), ("read", "write"), ("deliver",))
    }

    def ask(method, path, *scopes, **more):
        headers = {"Authorization": f"Bearer {secrets[scopes]}"}
        return getattr(client, method)(path, headers=headers, **more)

    body = {"destination": "pacs", "simulation_id": case}
    is_problem(ask("post", "/v1/deliveries", "read", json=body), 403, "scope-missing")
    assert ask("post", "/v1/deliveries", "deliver", json=body).status_code == 202
    is_problem(ask("post", "/v1/destinations", "deliver", json=PACS), 403, "scope-missing")
    listed = ask("get", "/v1/destinations", "deliver").json()["items"]
    assert [set(item) for item in listed] == [{"id", "name"}]
    is_problem(ask("get", f"/v1/destinations/{listed[0]['id']}", "deliver"), 403, "scope-missing")
    automatic = {"deliver": [{"destination": "pacs"}]}
    is_problem(ask("post", "/v1/simulations", "read", "write", json=automatic), 403, "scope-missing")


def test_a_study_is_delivered_case_by_case(client, make, finish):
    destination = make()
    study = {
        "base": {"name": "s"},
        "axes": [{"kind": "grid", "field": "seed", "values": [1, 2]}],
        "deliver": [{"destination": "pacs"}],
    }
    response = client.post("/v1/studies", json=study)
    assert response.status_code == 202, response.text
    posted = response.json()
    assert "deliver" not in posted["study"]
    cases = client.get(f"/v1/simulations?study_id={posted['id']}").json()["items"]
    finish(cases[0]["id"])
    (first,) = client.get("/v1/deliveries").json()["items"]
    assert (first["simulation_id"], first["automatic"]) == (cases[0]["id"], True)
    finish(cases[1]["id"])
    assert len(client.get("/v1/deliveries").json()["items"]) == 2
    # All of it once more, on request.
    body = {"destination": destination["id"], "study_id": posted["id"], "files": ["volume.dcm"]}
    whole = client.post("/v1/deliveries", json=body).json()
    assert {i["simulation_id"] for i in whole["instances"]} == {case["id"] for case in cases}
    assert (whole["study_id"], whole["instances_total"]) == (posted["id"], 2)


def test_a_study_without_an_end(client, make, is_problem):
    make()
    study = client.post("/v1/studies", json={"axes": [{"kind": "grid", "field": "seed", "values": [1, 2]}]}).json()
    body = {"destination": "pacs", "study_id": study["id"]}
    is_problem(client.post("/v1/deliveries", json=body), 409, "not-finished")
    is_problem(client.post("/v1/deliveries", json={**body, "study_id": "0" * 32}), 404, "study-not-found")
    is_problem(client.post("/v1/deliveries", json={**body, "series": ["1.2"]}), 422, "invalid-request")
