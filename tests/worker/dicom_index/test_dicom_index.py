"""The index of DICOM objects on both databases: conditions, order, counts, duplicates, cascades."""

import pytest

from simcore.store.hashing import FileRef
from worker.dicom_index.index import Condition, DicomIndex, Entry, Pixels
from worker.records.database import simulations
from worker.records.retention import ExpiredError

PIXELS = Pixels("7FE00010", "OW", 1000, None, 3, 4, 5, 1, 16)


def entry(study="1.2", series="1.2.1", uid="1.2.1.1", number: int | None = 1, modality="MG", **columns):
    values = dict.fromkeys(
        ("patient_id", "patient_name", "patient_birth_date", "patient_sex", "date", "time", "accession_number",
         "study_id", "referring_physician", "description"), "",
    )  # fmt: skip
    return Entry(
        f"{uid}.dcm",
        FileRef("a" * 64, 5_000_000_000),
        {
            "study": {**values, **columns, "uid": study},
            "series": {"uid": series, "modality": modality, "number": 1, "description": ""},
            "instance": {"uid": uid, "sop_class": "1.2.840", "number": number},
        },
        {"study": {"0020000D": study}, "series": {"0020000E": series}, "instance": {"00080018": uid}},
        "1.2.840.10008.1.2.5",
        PIXELS,
    )


@pytest.fixture
def index(engine, clock):
    return DicomIndex(engine, clock)


@pytest.fixture
def add(jobs, index):
    def make(*entries):
        identifier = jobs.create({}, {}).id
        assert jobs.claim(identifier, "test")
        assert jobs.succeed(identifier, "test", {"files": {}})
        assert index.missing()[0] == identifier
        assert index.add(identifier, entries)
        assert not index.add(identifier, entries)
        return identifier

    return make


def uids(index, level, *conditions, limit=100, offset=0):
    rows, total = index.search(level, conditions, limit, offset)
    return [f.instance or f.series or f.study for f in rows], total


def test_order_counts_and_pages(index, add):
    add(entry(uid="1", number=2), entry(uid="2", number=1), entry(series="1.2.2", uid="3", modality="SEG"))
    add(entry(study="1.3", series="1.3.1", uid="4"))
    assert uids(index, "study") == (["1.3", "1.2"], 2)
    assert uids(index, "instance") == (["4", "2", "1", "3"], 4)
    assert uids(index, "instance", limit=2, offset=1) == (["2", "1"], 4)
    assert uids(index, "instance", limit=2, offset=9) == ([], 4)
    (study,), _ = index.search("study", [Condition("StudyInstanceUID", ("1.2",))], 1, 0)
    assert study.attributes["00080061"]["Value"] == ["MG", "SEG"]
    assert (study.attributes["00201206"]["Value"], study.attributes["00201208"]["Value"]) == ([2], [3])
    assert index.missing() is None


def test_conditions(index, add):
    add(entry(patient_id="A_1", patient_name="Müller^X", date="20260101", time="120000", uid="1"))
    add(entry(study="1.3", patient_id="AB1", patient_name="MILLER%", date="", uid="2", modality="SEG", number=None))
    for condition, expected in (
        (Condition("PatientID", ("a_1",)), ["1.2"]),
        (Condition("PatientID", ("A?1",)), ["1.3", "1.2"]),
        (Condition("PatientName", ("*ller*",)), ["1.3", "1.2"]),
        (Condition("PatientName", ("miller%",)), ["1.3"]),
        (Condition("PatientName", ("m\\*",)), []),
        (Condition("PatientName", ("x", "mill*")), ["1.3"]),
        (Condition("StudyDate", span=(None, "20260101")), ["1.2"]),
        (Condition("StudyDate", span=("20260102", None)), []),
        (Condition("StudyTime", span=("115959", "120000")), ["1.2"]),
        (Condition("ModalitiesInStudy", ("SEG",)), ["1.3"]),
    ):
        assert uids(index, "study", condition)[0] == expected, condition
    assert uids(index, "instance", Condition("InstanceNumber", ("1",)))[0] == ["1"]


def test_an_instance_is_found_whole(index, add):
    add(entry())
    (row,) = index.instances("1.2", "1.2.1", "1.2.1.1")
    assert (row.pixels, row.file) == (PIXELS, FileRef("a" * 64, 5_000_000_000))
    assert index.instances("1.2", "1.2.9") == []


def test_the_same_study_twice_then_gone(index, add, jobs, clock, engine):
    first, second = add(entry()), add(entry())
    assert uids(index, "instance") == (["1.2.1.1"], 1)
    jobs.delete(second)
    assert uids(index, "instance") == (["1.2.1.1"], 1)
    with engine.begin() as connection:
        connection.execute(simulations.update().where(simulations.c.id == first).values(expires_at=clock() + 10))
    assert uids(index, "study") == (["1.2"], 1)
    clock.now += 10
    assert uids(index, "study") == ([], 0)
    with pytest.raises(ExpiredError):
        index.instances("1.2")
    jobs.delete(first)
    assert index.instances("1.2") == []


def test_a_case_that_is_deleted_meanwhile(index):
    assert not index.add("0" * 32, [entry()])
    assert uids(index, "study") == ([], 0)
