"""Grey pictures side by side with their names, as small PNG files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

GAP = 6
"""Distance of panels, pixels."""
LABEL = 26
"""Height of the line with the names, pixels."""
LEVELS = 48
"""Different greys of a picture: as many as a screen shows apart, and files of half the size."""
MAX_BYTES = 300_000

Panel = tuple[str, NDArray[np.uint8]]
"""Name and greys."""


def save_panels(rows: list[list[Panel]], target: Path) -> None:
    """Rows of named pictures in one PNG file.

    raises: ValueError where the file has more than MAX_BYTES.
    """
    width = max(sum(image.shape[1] + GAP for _, image in row) - GAP for row in rows)
    height = sum(max(image.shape[0] for _, image in row) + LABEL for row in rows)
    sheet = Image.new("L", (width, height), 255)
    draw = ImageDraw.Draw(sheet)
    top = 0
    for row in rows:
        left = 0
        for name, image in row:
            draw.text((left + 4, top + 3), name, fill=0, font=ImageFont.load_default(17))
            sheet.paste(Image.fromarray(image), (left, top + LABEL))
            left += image.shape[1] + GAP
        top += max(image.shape[0] for _, image in row) + LABEL
    target.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(target, optimize=True)
    if target.stat().st_size > MAX_BYTES:
        raise ValueError(f"{target} has {target.stat().st_size} bytes; at most {MAX_BYTES} are wanted: larger pixels")


def grey(image: NDArray[np.float32], window: tuple[float, float]) -> NDArray[np.uint8]:
    """Linear from black at window[0] to white at window[1], in LEVELS greys."""
    low, high = window
    level = np.rint(np.clip((image - low) / (high - low), 0.0, 1.0) * (LEVELS - 1))
    return np.asarray(np.rint(level * (255.0 / (LEVELS - 1))), np.uint8)


def resized(image: NDArray[np.float32], pixel_mm: float, wanted_mm: float) -> NDArray[np.float32]:
    """The image with pixels of another size, averaged over what they cover."""
    scale = pixel_mm / wanted_mm
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    how = Image.Resampling.BOX if scale < 1 else Image.Resampling.BICUBIC
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize(size, how))
