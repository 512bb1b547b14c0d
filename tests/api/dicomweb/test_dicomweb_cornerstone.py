"""OHIF's image loader (cornerstone) in headless Chromium, fed by the service over DICOMweb: every object that holds
pixels, every encoding, pixel for pixel as pydicom reads them.

    cd tests/viewer && npm ci        (what `make validate` does)
"""

import base64
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from tests.support.chromium import Browser
from tests.support.waiting import wait_for

VIEWER = Path(__file__).parents[2] / "viewer"
EXTRAS = ["presentation", "synthetic-2d", "ct", "attenuation", "report"]
NODE_MISSING = shutil.which("node") is None or not (VIEWER / "node_modules").is_dir()

pytestmark = [
    pytest.mark.sweep,
    pytest.mark.needs_chromium,
    pytest.mark.skipif(NODE_MISSING, reason="needs node, and `npm ci` in tests/viewer"),
]

# What loads, with the frames that are looked at. The loader leaves binary segmentations packed; a report has no pixels.
FRAMES = {
    "projections/0001.dcm": [1],
    "projections/0003.dcm": [1],
    "projections.dcm": [1, 3],
    "tomosynthesis.dcm": [1, 5, 9],
    "labels.dcm": [1, 5],
    "presentation/0002.dcm": [1],
    "synthetic_2d.dcm": [1],
    "ct/0004.dcm": [1],
    "attenuation.dcm": [1, 5],
    "lesions.dcm": [1, 2],
}


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of the viewer, bundled afresh."""
    folder = tmp_path_factory.mktemp("viewer")
    subprocess.run(["node", "build.mjs", str(folder)], cwd=VIEWER, check=True, timeout=300)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join(10)


@pytest.fixture(scope="module")
def settings(settings, page):
    """The viewer stands on an origin of its own, which has to be allowed to read."""
    return settings.model_copy(update={"cors_origins": page})


@pytest.fixture(scope="module")
def browser(page: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with closing(Browser(tmp_path_factory.mktemp("chromium"), "")) as started:
        started.call("Page.navigate", url=page)
        wait_for(lambda: started.value("typeof window.start === 'function'"), "the viewer")
        assert started.value("window.start()") == "started"
        yield started


def show(browser: Browser, address: str, case, name: str, frame: int = 1, voi_function: str = "") -> dict:
    shown = browser.value(f"window.show({address + case.url(name)!r}, {frame}, {voi_function!r})")
    kind = {"Uint8Array": "u1", "Uint16Array": "<u2", "Float32Array": "<f4", "Int16Array": "<i2", "Uint32Array": "<u4"}
    pixels = np.frombuffer(base64.b64decode(shown.pop("pixels")), kind[shown["type"]])
    rows, columns = shown["rows"], shown["columns"]
    if case.datasets[name].BitsAllocated == 1:
        pixels = np.unpackbits(pixels, bitorder="little")[: rows * columns]
    return {**shown, "pixels": pixels.reshape(rows, columns)}


def frame_of(dataset, frame: int):
    pixels = dataset.pixel_array
    return pixels[frame - 1] if pixels.ndim == 3 else pixels


@pytest.fixture(scope="module", params=["none", "jpeg-ls", "rle"])
def loaded(request, add_case, exported):
    return add_case(exported(seed=2, lesions=True, extras=EXTRAS, encoding=request.param), f"full {request.param}")


@pytest.mark.parametrize("name", FRAMES)
def test_every_object_loads_as_pydicom_reads_it(browser: Browser, address: str, loaded, name: str):
    d = loaded.datasets[name]
    for frame in FRAMES[name]:
        shown = show(browser, address, loaded, name, frame)
        np.testing.assert_array_equal(shown["pixels"], frame_of(d, frame))
        assert shown["invert"] == (d.PhotometricInterpretation == "MONOCHROME1")


WINDOWED = ("tomosynthesis.dcm", "synthetic_2d.dcm", "projections.dcm", "projections/0001.dcm", "ct/0004.dcm")


@pytest.mark.parametrize("name", WINDOWED)
def test_windows_are_those_of_the_file(browser: Browser, address: str, name: str, add_case, exported):
    """A viewport asks for the range of values that it draws; cornerstone throws where it knows no such function."""
    full = add_case(exported(seed=2, lesions=True, extras=EXTRAS), "full none")
    shown = show(browser, address, full, name)
    assert "error" not in shown
    d = full.datasets[name]
    groups = d.get("SharedFunctionalGroupsSequence")
    voi = groups[0].FrameVOILUTSequence[0] if groups else d
    if "WindowCenter" in voi:
        center, width = float(voi.WindowCenter), float(voi.WindowWidth)
        assert (shown["center"], shown["width"]) == (center, width)
        assert shown["range"] == {"lower": center - 0.5 - (width - 1) / 2, "upper": center - 0.5 + (width - 1) / 2}


def test_what_this_version_of_the_loader_cannot_show(browser: Browser, address: str, add_case, exported):
    """The first letter of VOI LUT Function is taken for all of it (cornerstone3D issue 2844). docs/dicomweb.md tells
    which objects that is; what changes here changes there."""
    full = add_case(exported(seed=2, lesions=True, extras=EXTRAS), "full none")
    error = "Invalid VOI LUT function"
    assert show(browser, address, full, "tomosynthesis.dcm", 1, "LINEAR")["error"] == error
    assert [name for name in FRAMES if show(browser, address, full, name).get("error") == error] == [
        "presentation/0002.dcm",
        "attenuation.dcm",
    ]


def test_sizes_of_pixels(browser: Browser, address: str, add_case, exported):
    """Where an object has Pixel Spacing, at whatever level; views have Imager Pixel Spacing, which the loader skips."""
    full = add_case(exported(seed=2, lesions=True, extras=EXTRAS), "full none")
    for name in ("tomosynthesis.dcm", "labels.dcm", "ct/0004.dcm"):
        assert show(browser, address, full, name)["spacing"] == [0.9, 0.85]
