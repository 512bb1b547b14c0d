"""The skin line: whether the border of the reconstructed breast stands where the skin is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DEEP_MM = (10.0, 15.0)
"""How far below the skin surface the tissue lies that the height of the skin line is compared with."""
OUTSIDE_MM = 5.0
"""How far the profile goes on outside the breast."""


@dataclass(frozen=True)
class SkinLine:
    """Mean profile along x, from the breast outwards, over the rows of one slice.

    position: float64 (n,), mm from the true outer border of the skin, negative inside the breast.
    profile:  float64 (n,), unit of the image. rows: how many were averaged.
    """

    position: NDArray[np.float64]
    profile: NDArray[np.float64]
    rows: int

    @property
    def border_mm(self) -> float | None:
        """Where the profile falls most steeply, mm outside (+) or inside (-) of the true border; None without rows."""
        if self.rows == 0:
            return None
        near = np.abs(self.position) <= 5.0
        fall = -np.gradient(self.profile[near], self.position[near])
        return float(self.position[near][int(np.argmax(fall))])

    @property
    def overshoot(self) -> float | None:
        """Largest value within 3 mm of the border less the mean value 10 to 15 mm deep; None without rows."""
        if self.rows == 0:
            return None
        near = np.abs(self.position) <= 3.0
        deep = (self.position >= -DEEP_MM[1]) & (self.position <= -DEEP_MM[0])
        return float(self.profile[near].max() - self.profile[deep].mean())


def skin_line(image: NDArray[np.generic], breast: NDArray[np.bool_], pixel_mm: float) -> SkinLine:
    """The skin line of one slice (ny, nx) from the mask of the breast with its skin, chest wall at column 0.

    Rows are used where the border leans by less than 45 degrees against them and enough pixels lie on both sides.
    """
    inside, outside = round(DEEP_MM[1] / pixel_mm), round(OUTSIDE_MM / pixel_mm)
    columns = breast.shape[1]
    # First column outside the breast; 0 in rows without breast.
    ends = np.where(breast.any(axis=1), columns - np.argmax(breast[:, ::-1], axis=1), 0)
    half = max(1, round(2.0 / pixel_mm))
    lean = np.full(len(ends), columns)
    lean[half:-half] = np.abs(ends[2 * half :] - ends[: -2 * half])
    rows = np.flatnonzero((ends >= inside) & (ends + outside <= columns) & (lean <= 2 * half))
    offsets = np.arange(-inside, outside)
    position = np.asarray((offsets + 0.5) * pixel_mm, np.float64)
    if len(rows) == 0:
        return SkinLine(position, np.zeros(len(position)), 0)
    profile = np.asarray(image, np.float64)[rows[:, None], ends[rows, None] + offsets].mean(axis=0)
    return SkinLine(position, profile, len(rows))


def skin_thickness(labels: NDArray[np.uint8], skin: int, pixel_mm: float) -> float | None:
    """Mean thickness of the skin in one slice of labels (ny, nx), mm, where its border is upright (leans by less
    than 10 degrees, so that a row crosses it at its true thickness within 2 %); None where it nowhere is."""
    columns = labels.shape[1]
    breast = labels != 0
    ends = np.where(breast.any(axis=1), columns - np.argmax(breast[:, ::-1], axis=1), 0)
    half = max(1, round(2.0 / pixel_mm))
    lean = np.full(len(ends), np.inf)
    lean[half:-half] = np.abs(ends[2 * half :] - ends[: -2 * half]) / (2 * half)
    upright = np.flatnonzero((lean < np.tan(np.deg2rad(10.0))) & (ends > 0) & (ends < columns))
    if len(upright) == 0:
        return None
    reach = min(round(5.0 / pixel_mm), int(ends[upright].min()))
    outermost = labels[upright[:, None], ends[upright, None] - 1 - np.arange(reach)]
    # Pixels from the border inwards until the first that is not skin.
    run = np.minimum.accumulate(outermost == skin, axis=1).sum(axis=1)
    return float(run.mean()) * pixel_mm
