"""Rendered frames hold the grey values that the standard's formulas give, as pydicom computes them."""

import io

import numpy as np
import pydicom
import pytest
from PIL import Image
from pydicom.pixels import apply_rescale, apply_windowing

from api.dicomweb.rendering import FrameLook, Look, Viewport, Window, Wish, picture

VOLUME = "tomosynthesis.dcm"


def shades(client, url, **parameters) -> np.ndarray:
    answer = client.get(url, params=parameters, headers={"Accept": "image/png"})
    assert answer.status_code == 200, answer.text
    return np.asarray(Image.open(io.BytesIO(answer.content))).astype(int)


def flat(dataset, frame):
    """The attributes that transform one frame, at top level; where the functional groups have none: identity."""
    out = pydicom.Dataset()
    out.update({e.tag: e for e in dataset if e.keyword.startswith(("Window", "Rescale", "VOILUTFunction"))})
    shared = dataset.get("SharedFunctionalGroupsSequence", [pydicom.Dataset()])[0]
    own = dataset.get("PerFrameFunctionalGroupsSequence", [pydicom.Dataset()] * frame)[frame - 1]
    for group in (shared, own):
        for keyword in ("FrameVOILUTSequence", "PixelValueTransformationSequence"):
            if keyword in group:
                out.update(group[keyword].value[0])
    out.PhotometricInterpretation = "MONOCHROME2"
    out.BitsStored = 16
    out.PixelRepresentation = 0
    return out


def expected(dataset, frame, **window) -> np.ndarray:
    """Grey values 0 to 255."""
    stored = dataset.pixel_array[frame - 1] if dataset.pixel_array.ndim == 3 else dataset.pixel_array
    attributes = flat(dataset, frame)
    for name, value in window.items():
        setattr(attributes, name, value)
    values = apply_rescale(stored, attributes)
    slope, intercept = float(attributes.get("RescaleSlope", 1)), float(attributes.get("RescaleIntercept", 0))
    y = apply_windowing(values, attributes)
    low, high = intercept, 65535 * slope + intercept  # what pydicom maps the window to
    grey = 255 * (y - low) / (high - low)
    inverted = dataset.get("PresentationLUTShape") == "INVERSE" or dataset.PhotometricInterpretation == "MONOCHROME1"
    return 255 - grey if inverted else grey


@pytest.mark.parametrize(("name", "frame"), [(VOLUME, 1), (VOLUME, 9), ("projections.dcm", 3)])
def test_the_window_of_the_object(client, case, name, frame):
    got = shades(client, f"{case.url(name)}/frames/{frame}/rendered")
    assert np.abs(got - expected(case.datasets[name], frame)).max() <= 1
    assert got.std() > 20


@pytest.mark.parametrize(
    ("text", "window"),
    [
        ("22000,500", {"WindowCenter": 22000, "WindowWidth": 500, "VOILUTFunction": "LINEAR"}),
        ("22000,4", {"WindowCenter": 22000, "WindowWidth": 4, "VOILUTFunction": "LINEAR"}),
        ("22000.5,1", {"WindowCenter": 22000.5, "WindowWidth": 1, "VOILUTFunction": "LINEAR"}),
        ("22000,3000,linear-exact", {"WindowCenter": 22000, "WindowWidth": 3000, "VOILUTFunction": "LINEAR_EXACT"}),
        ("22000,3000,sigmoid", {"WindowCenter": 22000, "WindowWidth": 3000, "VOILUTFunction": "SIGMOID"}),
    ],
)
def test_a_window_of_ones_own(client, case, text, window):
    dataset = case.datasets[VOLUME]
    got = shades(client, f"{case.url(VOLUME)}/frames/4/rendered", window=text)
    assert np.abs(got - expected(dataset, 4, **window)).max() <= 1
    assert len(np.unique(got)) > 1


def test_the_frame_that_stands_for_the_volume(client, case):
    frame = int(case.datasets[VOLUME].RepresentativeFrameNumber)
    whole = shades(client, f"{case.url(VOLUME)}/rendered")
    assert np.array_equal(whole, shades(client, f"{case.url(VOLUME)}/frames/{frame}/rendered"))
    assert not np.array_equal(whole, shades(client, f"{case.url(VOLUME)}/frames/1/rendered"))


def test_labels_without_a_window_fill_the_range(client, case):
    stored = case.datasets["labels.dcm"].pixel_array[4]
    got = shades(client, f"{case.url('labels.dcm')}/frames/5/rendered")
    assert (got.min(), got.max()) == (0, 255)
    order = np.argsort(stored, axis=None, kind="stable")
    assert (np.diff(got.ravel()[order]) >= 0).all()


def test_regions_and_turns(client, case):
    url = f"{case.url(VOLUME)}/frames/2/rendered"
    whole = shades(client, url)
    part = whole[5:25, 10:40]
    assert np.array_equal(shades(client, url, viewport="30,20,10,5,30,20"), part)
    assert np.array_equal(shades(client, url, viewport="30,20,10,5,-30,20"), part[:, ::-1])
    assert np.array_equal(shades(client, url, viewport="30,20,10,5,30,-20"), part[::-1])


@pytest.mark.parametrize(("viewport", "size"), [("25,1000", (25, 30)), ("500,122", (100, 122)), ("1,1", (1, 1))])
def test_a_viewport_keeps_the_proportions(client, case, viewport, size):
    got = shades(client, f"{case.url(VOLUME)}/frames/2/rendered", viewport=viewport)
    assert (got.shape[1], got.shape[0]) == size


def test_quality(client, case):
    sizes = [len(client.get(f"{case.url(VOLUME)}/rendered", params={"quality": q}).content) for q in (5, 50, 100)]
    assert sizes == sorted(sizes)
    assert sizes[0] < sizes[2] / 4


@pytest.mark.parametrize("kind", ["<u1", "<u2", "<i2", "<u4", "<f4", "<f8"])
def test_every_kind_of_stored_value(kind):
    array = np.array([[0, 50, 100, 127]], np.dtype(kind))
    look = Look((FrameLook(2.0, -10.0, Window(95.0, 200.0, "LINEAR_EXACT")),), False, kind == "<i2", 1)
    stored = array.view("<u2") if kind == "<i2" else array
    got = np.asarray(Image.open(io.BytesIO(picture(stored, look, 1, Wish(), "image/png"))))
    assert got.tolist() == [np.rint(255 * np.clip((np.array([-10, 90, 190, 244]) - 95) / 200 + 0.5, 0, 1)).tolist()]


def test_negative_stored_values():
    array = np.array([[-100, 0, 100]], "<i2").view("<u2")
    look = Look((FrameLook(1.0, 0.0, None),), False, True, 1)
    got = np.asarray(Image.open(io.BytesIO(picture(array, look, 1, Wish(), "image/png"))))
    assert got.tolist() == [[0, 128, 255]]


def test_a_flat_frame_and_colours():
    look = Look((FrameLook(1.0, 0.0, None),), False, False, 1)
    flat_frame = np.full((3, 3), 7, np.uint16)
    assert np.ptp(np.asarray(Image.open(io.BytesIO(picture(flat_frame, look, 1, Wish(), "image/png"))))) == 0
    colours = np.arange(27, dtype=np.uint8).reshape(3, 3, 3)
    wish = Wish(viewport=Viewport(3, 3))
    assert Image.open(io.BytesIO(picture(colours, look, 1, wish, "image/png"))).mode == "RGB"
