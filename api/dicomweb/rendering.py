"""A frame as people see it: modality and window transformation, region, scale, PNG or JPEG (PS3.18, 8.3.5)."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydicom.dataset import Dataset

from api.dicomweb.query import bad_query
from simcore.store.hashing import FileRef
from simcore.store.store import Store
from worker.dicom_index.files import open_stored, read_header

MAX_EDGE = 8192
"""Longest edge of a viewport, pixel."""

DEFAULT_QUALITY = 90

_FUNCTIONS = {"linear": "LINEAR", "linear-exact": "LINEAR_EXACT", "sigmoid": "SIGMOID"}
_NUMBER = r"[+-]?(?:[0-9]{1,12}(?:\.[0-9]{0,12})?|\.[0-9]{1,12})(?:[eE][+-]?[0-9]{1,2})?"
_WINDOW = re.compile(rf"({_NUMBER}),({_NUMBER})(?:,([A-Za-z_-]+))?")


@dataclass(frozen=True)
class Window:
    """Values from centre - width / 2 to centre + width / 2 are shown; function: as VOI LUT Function says."""

    centre: float
    width: float
    function: str = "LINEAR"


@dataclass(frozen=True)
class Viewport:
    """Size of the picture, and the region of the frame that is shown (the whole of it where None). Pixel."""

    width: int
    height: int
    region: tuple[int, int, int, int] | None = None


@dataclass(frozen=True)
class Wish:
    """What the query parameters ask for."""

    window: Window | None = None
    viewport: Viewport | None = None
    quality: int = DEFAULT_QUALITY


@dataclass(frozen=True)
class FrameLook:
    """Value = slope x stored + intercept, and the window that the object itself gives."""

    slope: float
    intercept: float
    window: Window | None


@dataclass(frozen=True)
class Look:
    """How the frames of a file are to be shown; representative: the frame that stands for all, 1 ..."""

    frames: tuple[FrameLook, ...]
    inverted: bool
    signed: bool
    representative: int


@lru_cache(maxsize=256)
def look(store: Store, ref: FileRef) -> Look:
    """Read from the attributes of a stored file, whose content never changes. raises: OSError"""
    with open_stored(store, ref) as file:
        dataset = read_header(file).dataset
    count = int(dataset.get("NumberOfFrames") or 1)
    shared = _first(dataset, "SharedFunctionalGroupsSequence")
    groups = dataset.get("PerFrameFunctionalGroupsSequence") or [Dataset()] * count
    return Look(
        frames=tuple(_frame_look(dataset, shared, group) for group in groups),
        inverted=dataset.get("PresentationLUTShape") == "INVERSE"
        or dataset.get("PhotometricInterpretation") == "MONOCHROME1",
        signed=dataset.get("PixelRepresentation", 0) == 1,
        representative=int(dataset.get("RepresentativeFrameNumber") or count // 2 + 1),
    )


def parse(parameters: Mapping[str, str]) -> Wish:
    """The parameters window, viewport and quality.

    raises: ApiError 400 naming the parameter, its value and what is allowed
    """
    if "annotation" in parameters or "iccprofile" in parameters:
        raise bad_query("annotation, iccprofile", "", "not supported: leave them out")
    window = viewport = None
    quality = DEFAULT_QUALITY
    if (text := parameters.get("window")) is not None:
        window = _window(text)
    if (text := parameters.get("viewport")) is not None:
        viewport = _viewport(text)
    if (text := parameters.get("quality")) is not None:
        if not re.fullmatch("[0-9]{1,3}", text) or not 1 <= int(text) <= 100:
            raise bad_query("quality", text, "a whole number from 1 to 100")
        quality = int(text)
    return Wish(window, viewport, quality)


def picture(array: NDArray[Any], look: Look, frame: int, wish: Wish, media_type: str) -> bytes:
    """A frame (stored values) as image/png or image/jpeg; frame: its number, 1 ...

    raises: ApiError 400 where the region lies outside
    """
    grey = _shown(_region(array, wish.viewport), look, look.frames[frame - 1], wish.window)
    image = Image.fromarray(grey)
    if wish.viewport is not None:
        scale = min(wish.viewport.width / image.width, wish.viewport.height / image.height)
        size = (max(1, round(scale * image.width)), max(1, round(scale * image.height)))
        image = image.resize(size, Image.Resampling.BOX if scale < 1 else Image.Resampling.BICUBIC)
    buffer = io.BytesIO()
    if media_type == "image/png":
        image.save(buffer, "png", compress_level=1)
    else:
        image.save(buffer, "jpeg", quality=wish.quality)
    return buffer.getvalue()


def _shown(array: NDArray[Any], look: Look, frame: FrameLook, window: Window | None) -> NDArray[np.uint8]:
    """Shades of grey, or the colours as they are."""
    if array.ndim == 3:
        return array.astype(np.uint8)
    if array.dtype.kind == "f":
        return _grey(array.astype(np.float64), look, frame, window, array)
    if look.signed:
        array = array.view(array.dtype.str.replace("u", "i"))
    if array.dtype.itemsize > 2:
        return _grey(array.astype(np.float64), look, frame, window, array)
    # A table of all stored values is a hundredth of the work.
    info = np.iinfo(array.dtype)
    table = _grey(np.arange(info.min, info.max + 1, dtype=np.float64), look, frame, window, array)
    shades: NDArray[np.uint8] = table[array.astype(np.int32) - info.min]
    return shades


def _grey(
    stored: NDArray[np.float64], look: Look, frame: FrameLook, window: Window | None, array: NDArray[Any]
) -> NDArray[np.uint8]:
    """Shades of stored values; array: all of the frame, for a window of its own where the object gives none."""
    chosen = window or frame.window or _own_window(array, frame)
    x = stored * frame.slope + frame.intercept
    if chosen.function == "SIGMOID":
        y = 1 / (1 + np.exp(np.clip(-4 * (x - chosen.centre) / chosen.width, -50, 50)))
    elif chosen.function == "LINEAR_EXACT":
        y = (x - chosen.centre) / chosen.width + 0.5
    elif chosen.width == 1:
        y = np.where(x > chosen.centre - 0.5, 1.0, 0.0)
    else:
        y = (x - (chosen.centre - 0.5)) / (chosen.width - 1) + 0.5
    y = np.clip(y, 0, 1)
    shades = np.rint(255 * (1 - y if look.inverted else y))
    return np.asarray(shades, np.uint8)


def _own_window(array: NDArray[Any], frame: FrameLook) -> Window:
    """From the least to the largest value of the frame."""
    ends = [float(value) * frame.slope + frame.intercept for value in (array.min(), array.max())]
    width = abs(ends[1] - ends[0]) or 1.0
    return Window((ends[0] + ends[1]) / 2, width, "LINEAR_EXACT")


def _region(array: NDArray[Any], viewport: Viewport | None) -> NDArray[Any]:
    if viewport is None or viewport.region is None:
        return array
    x, y, width, height = viewport.region
    rows, columns = array.shape[:2]
    if x + abs(width) > columns or y + abs(height) > rows:
        raise bad_query("viewport", f"{x},{y},{width},{height}", f"a region within the {columns} x {rows} pixels")
    part = array[y : y + abs(height), x : x + abs(width)]
    return part[:: -1 if height < 0 else 1, :: -1 if width < 0 else 1]


def _window(text: str) -> Window:
    allowed = "centre,width or centre,width,function with width > 0 and function linear, linear-exact or sigmoid"
    match = _WINDOW.fullmatch(text)
    if match is None:
        raise bad_query("window", text, allowed)
    function = _FUNCTIONS.get((match[3] or "linear").lower().replace("_", "-"))
    centre, width = float(match[1]), float(match[2])
    if function is None or width <= 0 or (function == "LINEAR" and width < 1):
        raise bad_query("window", text, allowed + "; for linear the width is 1 or more")
    return Window(centre, width, function)


def _viewport(text: str) -> Viewport:
    allowed = (
        f"width,height (1 to {MAX_EDGE}), or width,height,x,y,w,h with the region of the frame in whole pixels; "
        "a negative w or h turns it round"
    )
    if not re.fullmatch(r"[0-9]{1,5},[0-9]{1,5}(,[0-9]{1,6},[0-9]{1,6},-?[0-9]{1,6},-?[0-9]{1,6})?", text):
        raise bad_query("viewport", text, allowed)
    width, height, *region = (int(part) for part in text.split(","))
    if not (1 <= width <= MAX_EDGE and 1 <= height <= MAX_EDGE) or (region and 0 in region[2:]):
        raise bad_query("viewport", text, allowed)
    return Viewport(width, height, (region[0], region[1], region[2], region[3]) if region else None)


def _frame_look(dataset: Dataset, shared: Dataset, group: Dataset) -> FrameLook:
    value = _macro(group, shared, "PixelValueTransformationSequence") or dataset
    voi = _macro(group, shared, "FrameVOILUTSequence") or dataset
    centre, width = _number(voi, "WindowCenter"), _number(voi, "WindowWidth")
    window = None
    if centre is not None and width is not None and width > 0:
        window = Window(centre, width, str(voi.get("VOILUTFunction") or "LINEAR"))
    slope, intercept = _number(value, "RescaleSlope"), _number(value, "RescaleIntercept")
    return FrameLook(1.0 if slope is None else slope, intercept or 0.0, window)


def _macro(group: Dataset, shared: Dataset, keyword: str) -> Dataset | None:
    for place in (group, shared):
        if place.get(keyword):
            item: Dataset = place[keyword].value[0]
            return item
    return None


def _first(dataset: Dataset, keyword: str) -> Dataset:
    return dataset[keyword].value[0] if dataset.get(keyword) else Dataset()


def _number(dataset: Dataset, keyword: str) -> float | None:
    """The first value of an attribute; None where there is none, or no finite one."""
    value = dataset.get(keyword)
    if isinstance(value, (list, tuple)) or (value is not None and hasattr(value, "__iter__")):
        value = next(iter(value), None)
    if value is None or not math.isfinite(float(value)):
        return None
    return float(value)
