"""Accept headers, query strings, windows and viewports: what clients send, and what nobody should."""

from contextlib import suppress

import pytest
from fastapi import Request
from hypothesis import given
from hypothesis import strategies as st

from api.dicomweb import accept, query, rendering
from api.dicomweb.retrieve import frame_numbers
from api.http.errors import ApiError
from worker.dicom_index.index import Condition

EXPLICIT = "1.2.840.10008.1.2.1"
RLE = "1.2.840.10008.1.2.5"
JLS = "1.2.840.10008.1.2.4.80"


def asking(header: str | None = None, parameters: str = "") -> Request:
    headers = [] if header is None else [(b"accept", header.encode())]
    return Request({"type": "http", "method": "GET", "headers": headers, "query_string": parameters.encode()})


@pytest.mark.parametrize(
    ("header", "syntax", "count", "expected"),
    [
        (None, EXPLICIT, 3, (True, True)),
        ("*/*", RLE, 3, (True, False)),
        ('multipart/related; type="application/dicom"', RLE, 1, (True, False)),
        ('multipart/related; type="application/dicom"; transfer-syntax=*', RLE, 1, (True, True)),
        ('multipart/related; type="application/dicom"; transfer-syntax="*"', RLE, 1, (True, True)),
        ("multipart/related; type=application/dicom; transfer-syntax=1.2.840.10008.1.2.5", RLE, 1, (True, True)),
        ("multipart/related;type=application/dicom;transfer-syntax=1.2.840.10008.1.2.1", RLE, 1, (True, False)),
        ("multipart/related", RLE, 2, (True, False)),
        ("application/dicom", EXPLICIT, 1, (False, True)),
        ("application/dicom; transfer-syntax=*", JLS, 1, (False, True)),
        ("application/dicom, multipart/related; type=application/dicom", EXPLICIT, 2, (True, True)),
        (f'application/dicom; transfer-syntax={JLS}, multipart/related; type="*/*"', RLE, 1, (True, False)),
        ("application/dicom;q=0.1, multipart/related;type=application/dicom;q=0.9", EXPLICIT, 1, (True, True)),
        ("text/html, application/xhtml+xml, */*;q=0.8", EXPLICIT, 1, (True, True)),
    ],
)
def test_objects(header, syntax, count, expected):
    chosen = accept.choose_dicom(asking(header), {syntax}, count)
    assert (chosen.multipart, chosen.stored) == expected


@pytest.mark.parametrize(
    ("header", "syntax", "count"),
    [
        ("application/dicom", EXPLICIT, 2),
        ("text/html", EXPLICIT, 1),
        ('multipart/related; type="application/dicom+xml"', EXPLICIT, 1),
        (f'multipart/related; type="application/dicom"; transfer-syntax={JLS}', RLE, 1),
        ("multipart/related; type=application/dicom; transfer-syntax=1.2.840.10008.1.2", EXPLICIT, 1),
        ("application/dicom;q=0", EXPLICIT, 1),
        (";;;,,,", EXPLICIT, 1),
        ("\x80", EXPLICIT, 1),
    ],
)
def test_objects_that_cannot_be_sent(header, syntax, count):
    with pytest.raises(ApiError) as refused:
        accept.choose_dicom(asking(header), {syntax}, count)
    assert (refused.value.status, refused.value.code) == (406, "not-acceptable")


OHIF = "multipart/related; type=application/octet-stream; transfer-syntax=*"


@pytest.mark.parametrize(
    ("header", "syntax", "count", "expected"),
    [
        (None, RLE, 2, ("application/octet-stream", True, False)),
        (None, EXPLICIT, 2, ("application/octet-stream", True, True)),
        (OHIF, EXPLICIT, 1, ("application/octet-stream", True, True)),
        (OHIF, RLE, 1, ("application/octet-stream", True, True)),
        ('multipart/related; type="*/*"', RLE, 2, ("application/octet-stream", True, False)),
        ("*/*; transfer-syntax=*", RLE, 2, ("image/dicom-rle", True, True)),
        ('multipart/related; type="image/jls"', JLS, 2, ("image/jls", True, True)),
        (f'multipart/related; type="image/x-jls"; transfer-syntax={JLS}', JLS, 1, ("image/x-jls", True, True)),
        ('multipart/related; type="image/*"', RLE, 1, ("image/dicom-rle", True, True)),
        ("application/octet-stream", RLE, 1, ("application/octet-stream", False, False)),
        ("image/dicom-rle", RLE, 1, ("image/dicom-rle", False, True)),
        (
            'multipart/related; type="image/jls"; q=0.9, multipart/related; type="application/octet-stream"; q=0.5',
            EXPLICIT,
            1,
            ("application/octet-stream", True, True),
        ),
    ],
)
def test_frames(header, syntax, count, expected):
    chosen = accept.choose_pixels(asking(header), syntax, count)
    assert (chosen.media_type, chosen.multipart, chosen.stored) == expected


@pytest.mark.parametrize(
    ("header", "syntax", "count"),
    [
        ("application/octet-stream", EXPLICIT, 2),
        ('multipart/related; type="image/jls"', EXPLICIT, 1),
        ('multipart/related; type="image/*"', EXPLICIT, 1),
        (f'multipart/related; type="image/jls"; transfer-syntax={RLE}', JLS, 1),
        ('multipart/related; type="video/mp4"', EXPLICIT, 1),
        (f'multipart/related; type="application/octet-stream"; transfer-syntax={JLS}', RLE, 1),
    ],
)
def test_frames_that_cannot_be_sent(header, syntax, count):
    with pytest.raises(ApiError) as refused:
        accept.choose_pixels(asking(header), syntax, count)
    assert refused.value.status == 406


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (None, "application/dicom+json"),
        ("application/dicom+json, application/json", "application/dicom+json"),
        ("application/json", "application/json"),
        ("application/*", "application/dicom+json"),
        ("application/json;q=0.9, application/dicom+json;q=0.2", "application/json"),
    ],
)
def test_json(header, expected):
    assert accept.choose_json(asking(header)) == expected


@pytest.mark.parametrize("header", ["application/dicom+xml", 'multipart/related; type="application/dicom+xml"'])
def test_no_xml(header):
    with pytest.raises(ApiError):
        accept.choose_json(asking(header))


@pytest.mark.parametrize(
    ("header", "parameters", "expected"),
    [
        (None, "", ("image/jpeg", False)),
        ("image/png", "", ("image/png", False)),
        ("image/", "", ("image/jpeg", False)),
        ("image/webp, image/*;q=0.8", "", ("image/jpeg", False)),
        ('multipart/related; type="image/png"', "", ("image/png", True)),
        ("text/html", "accept=image/png", ("image/png", False)),
    ],
)
def test_pictures(header, parameters, expected):
    assert accept.choose_picture(asking(header, parameters)) == expected


def test_a_very_long_accept_header():
    with pytest.raises(ApiError) as refused:
        accept.choose_json(asking("a/b," * 2000))
    assert refused.value.status == 400


@given(st.text(max_size=300))
def test_any_accept_header_is_read_or_refused(header):
    for accepted in accept.parse(header):
        assert 0 < accepted.quality <= 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("PatientID=SIM-1", Condition("PatientID", ("SIM-1",))),
        ("00100020=SIM-1", Condition("PatientID", ("SIM-1",))),
        ("0020000d=1.2,1.3", Condition("StudyInstanceUID", ("1.2", "1.3"))),
        ("StudyInstanceUID=1.2\\1.3", Condition("StudyInstanceUID", ("1.2", "1.3"))),
        ("StudyInstanceUID=1.2&StudyInstanceUID=1.3", Condition("StudyInstanceUID", ("1.2", "1.3"))),
        ("PatientName=*SYN**THETIC*", Condition("PatientName", ("*SYN*THETIC*",))),
        ("PatientName=A,B", Condition("PatientName", ("A,B",))),
        ("ModalitiesInStudy=MG,SEG", Condition("ModalitiesInStudy", ("MG", "SEG"))),
        ("Modality=MG", Condition("ModalitiesInStudy", ("MG",))),
        ("StudyDate=20260101", Condition("StudyDate", span=("20260101", "20260101"))),
        ("StudyDate=20260101-", Condition("StudyDate", span=("20260101", None))),
        ("StudyDate=-20260101", Condition("StudyDate", span=(None, "20260101"))),
        ("StudyDate=20250101-20260101", Condition("StudyDate", span=("20250101", "20260101"))),
        ("StudyTime=12", Condition("StudyTime", span=("120000", "125959.999999"))),
        ("StudyTime=1200-130000.5", Condition("StudyTime", span=("120000", "130000.599999"))),
    ],
)
def test_conditions(text, expected):
    pairs = [tuple(part.split("=", 1)) for part in text.split("&")]
    assert query.parse("study", pairs).conditions == [expected]


@pytest.mark.parametrize("text", ["PatientID=", "PatientID=*", "PatientName=**", "StudyInstanceUID=*", "StudyDate="])
def test_everything_is_wanted(text):
    assert query.parse("study", [tuple(text.split("=", 1))]).conditions == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("NoSuchThing", "1"),
        ("0010002", "1"),
        ("'; drop table dicom_studies; --", "1"),
        ("StudyInstanceUID", "1.2.x"),
        ("StudyInstanceUID", "1" * 65),
        ("StudyInstanceUID", ",".join(["1.2"] * 2001)),
        ("StudyDate", "2026-01-01"),
        ("StudyDate", "2026*"),
        ("StudyDate", "-"),
        ("StudyDate", "20260101\\20260102"),
        ("StudyTime", "noon"),
        ("PatientName", "*a" * 9),
        ("PatientName", "x" * 1025),
        ("PatientName", "a\0b"),
        ("limit", "0"),
        ("limit", "-1"),
        ("limit", "1_0"),
        ("limit", "٣"),
        ("limit", "9" * 40),
        ("offset", "x"),
        ("offset", "99999999999"),
        ("fuzzymatching", "maybe"),
        ("includefield", "NoSuchThing"),
    ],
)
def test_bad_queries(name, value):
    with pytest.raises(ApiError) as refused:
        query.parse("study", [(name, value)])
    assert refused.value.status == 400
    assert len(refused.value.detail) < 1000
    assert refused.value.errors[0]["detail"].startswith("allowed: ")


@pytest.mark.parametrize("name", ["fuzzymatching", "emptyvaluematching", "multiplevaluematching"])
def test_what_is_not_supported_is_told(name):
    assert name in query.parse("study", [(name, "true")]).warnings[0]
    assert query.parse("study", [(name, "false")]).warnings == []


@pytest.mark.parametrize("name", ["KVP", "SeriesNumber", "00400275.00400009", "00990010"])
def test_attributes_that_are_not_matched_are_told(name):
    parsed = query.parse("study", [(name, "1")])
    assert parsed.conditions == []
    assert "not supported" in parsed.warnings[0]


def test_fields_to_include():
    parsed = query.parse("study", [("includefield", "00081030,PatientAge"), ("includefield", "KVP"), ("limit", "5000")])
    assert {"00081030", "00101010", "00180060"} <= parsed.include
    assert parsed.limit == query.MAX_RESULTS
    assert query.parse("study", [("includeField", "all")]).include_all


@given(
    st.lists(st.tuples(st.sampled_from(["PatientName", "StudyDate", "limit", "includefield"]), st.text(max_size=40)))
)
def test_any_query_is_read_or_refused(pairs):
    with suppress(ApiError):
        query.parse("instance", pairs)


@pytest.mark.parametrize("text", ["", "0x1", "1,,2", "1, 2", "-1", "1" * 10, "1,1", "1;2"])
def test_bad_frame_lists(text):
    with pytest.raises(ApiError) as refused:
        frame_numbers(text, 9)
    assert refused.value.status == 400


@pytest.mark.parametrize("text", ["0", "10", "1,10"])
def test_frames_that_are_not_there(text):
    with pytest.raises(ApiError) as refused:
        frame_numbers(text, 9)
    assert refused.value.status == 404


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("window", "1"),
        ("window", "1,0"),
        ("window", "1,0.5"),
        ("window", "1,2,cubic"),
        ("window", "nan,1"),
        ("window", "1e999,1"),
        ("viewport", "0,5"),
        ("viewport", "9000,1"),
        ("viewport", "5"),
        ("viewport", "5,5,0,0,0,5"),
        ("viewport", "5,5,-1,0,5,5"),
        ("quality", "0"),
        ("quality", "101"),
        ("quality", "high"),
        ("annotation", "patient"),
    ],
)
def test_bad_rendering(name, value):
    with pytest.raises(ApiError) as refused:
        rendering.parse({name: value})
    assert (refused.value.status, refused.value.code) == (400, "bad-query")


def test_rendering_parameters():
    wish = rendering.parse({"window": "-1.5,2e3,Linear_Exact", "viewport": "10,20,1,2,-3,4", "quality": "7"})
    assert wish.window == rendering.Window(-1.5, 2000.0, "LINEAR_EXACT")
    assert wish.viewport == rendering.Viewport(10, 20, (1, 2, -3, 4))
    assert wish.quality == 7
