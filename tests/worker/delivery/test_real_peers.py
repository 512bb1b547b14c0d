"""Deliveries to dcmtk's storescp and to Orthanc, and what they make of mistakes."""

import numpy as np
import pytest
from pydicom import dcmread

from worker.delivery.echo import echo


@pytest.mark.needs_dcmtk
def test_a_case_to_storescp(room, storescp):
    peer = storescp()
    items = room.case()
    row = room.deliver(peer.port, items)
    assert (row.state, row.error, row.instances_stored, row.attempt) == ("succeeded", None, 4, 1)
    assert row.bytes_stored == row.bytes == sum(item.size for item in items)
    assert len(peer.stored()) == 4
    pixels = [dcmread(p).pixel_array for p in peer.folder.iterdir()]
    assert {p.tobytes() for p in pixels} == {p.tobytes() for p in room.pixels.values()}


@pytest.mark.needs_orthanc
def test_a_case_to_orthanc_and_back(room, orthanc):
    peer = orthanc()
    items = room.case()
    row = room.deliver(peer.port, items)
    assert (row.state, row.error, row.instances_stored) == ("succeeded", None, 4)
    for instance in room.deliveries.instances(row.id):
        study = "2.25.7"
        series = f"{study}.{2 if instance.name == 'volume.dcm' else 1}"
        path = f"/dicom-web/studies/{study}/series/{series}/instances/{instance.sop_instance}/frames"
        expected = room.pixels[instance.name]
        for number, frame in enumerate(expected, 1):
            answer = peer.http.get(
                f"{path}/{number}", headers={"Accept": 'multipart/related; type="application/octet-stream"'}
            )
            assert answer.is_success, answer.text
            body = answer.content.split(b"\r\n\r\n", 1)[1]
            pixels = np.frombuffer(body[: frame.nbytes], np.uint16).reshape(frame.shape)
            assert np.array_equal(pixels, frame)


@pytest.mark.needs_orthanc
def test_orthanc_with_an_unknown_calling_title(room, orthanc):
    """Association and echo are fine; the first C-STORE gets no answer."""
    peer = orthanc(DicomAlwaysAllowStore=False)
    destination = room.destination(peer.port, limits={"attempts": 2})
    assert echo(destination.definition, room.settings)["reachable"]
    row = room.run(room.queue(destination, room.case(1)))
    assert row.state == "failed"
    assert row.error["code"] == "no-answer"
    assert "allows TOMOSIM to store" in row.error["message"]
    assert peer.instances() == []
