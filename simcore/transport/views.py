"""One view as the kernels see it: the beam, the field on the detector, the coarse grid that counts scatter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.geometry import AcquisitionGeometry
from simcore.physics.attenuation import cross_sections
from simcore.physics.spectrum import Emission
from simcore.transport.collisions import Screen, Vector
from simcore.transport.histories import Beam, Start
from simcore.transport.scene import Setting

FloatArray = NDArray[np.float64]
FAVOURED = 0.35
"""How much energies are favoured that get through: exp(-this mu t) is taken out of the spectrum that is drawn from."""
PLAIN = 0.2
"""Share of the photons drawn from the spectrum itself: without them soft photons, which matter to the dose of the skin,
are drawn next to never and weigh a thousand times as much."""
DECAY = 0.4
"""The usual weight of photons falls with depth by exp(-this mu depth)."""


def shares_of(spectrum: Emission) -> FloatArray:
    """Share of each energy in the photons."""
    return np.asarray(spectrum.photons / spectrum.photons.sum())


def coarse_shape(geometry: AcquisitionGeometry, grid_mm: float) -> tuple[int, int]:
    """Rows and columns of the grid that counts scatter: it covers the detector with cells near ``grid_mm``."""
    detector = geometry.detector
    rows, columns = (max(4, round(count * detector.pixel / grid_mm)) for count in (detector.ny, detector.nx))
    return rows, columns


def cell_sides(geometry: AcquisitionGeometry, shape: tuple[int, int]) -> tuple[float, float]:
    """Edges of a cell of that grid along rows and columns index, mm."""
    detector = geometry.detector
    return detector.ny * detector.pixel / shape[0], detector.nx * detector.pixel / shape[1]


def beam_of(setting: Setting, spectrum: Emission) -> Beam:
    """The spectrum with its attenuation in the materials and the hands of a scene."""
    energies, shares = spectrum.energies_keV, shares_of(spectrum)
    used = shares > 0
    energies, shares = energies[used], shares[used]
    attenuation = np.zeros((len(energies), len(setting.materials), 2))
    for number, material in enumerate(setting.materials):
        if material is not None:
            sections = cross_sections(material, energies)
            attenuation[:, number, 0] = sections.photo
            attenuation[:, number, 1] = sections.coherent + sections.incoherent
    total = attenuation.sum(axis=-1)
    hand = np.stack([total[:, cards].mean(axis=1) for cards in setting.scene.hands], axis=-1)
    hand[:, 0] = 0.0
    typical = _typical(setting, total)
    getting_through = shares * np.exp(-FAVOURED * typical * (setting.scene.high[2] - setting.scene.low[2]))
    favoured = PLAIN * shares + (1 - PLAIN) * getting_through / getting_through.sum()
    return Beam(
        energy=energies,
        cumulative=np.cumsum(favoured),
        weight=shares / favoured,
        attenuation=np.ascontiguousarray(attenuation, np.float32),
        hand=np.ascontiguousarray(hand, np.float32),
        decay=DECAY * typical,
    )


def _typical(setting: Setting, total: FloatArray) -> FloatArray:
    """Mean attenuation of the tissue at each energy, 1/mm; that of the plates where there is none."""
    volumes = setting.cells.volumes()
    volumes[0] = 0.0
    if volumes.sum() > 0:
        return np.asarray(total[:, : len(volumes)] @ volumes / volumes.sum())
    plates = list(setting.plates)
    return np.asarray(total[:, plates].mean(axis=1)) if plates else np.zeros(len(total))


def screen_of(geometry: AcquisitionGeometry, view: int, shape: tuple[int, int]) -> Screen:
    """The coarse grid of one view."""
    first, rows, columns = field_of(geometry, view)
    sides = cell_sides(geometry, shape)
    return Screen(
        origin=_vector(first),
        row=_vector(rows / np.linalg.norm(rows)),
        column=_vector(columns / np.linalg.norm(columns)),
        normal=_vector(geometry.normal(view)),
        per_mm=1 / np.array(sides),
        middle=float(np.linalg.norm(rows)) / 2,
    )


def start_of(geometry: AcquisitionGeometry, view: int, kept: FloatArray, shift: FloatArray) -> Start:
    """The field of one view."""
    first, rows, columns = field_of(geometry, view)
    return Start(
        source=_vector(geometry.sources[view]),
        first=_vector(first),
        rows=_vector(rows),
        columns=_vector(columns),
        normal=_vector(geometry.normal(view)),
        kept=kept,
        shift=shift,
    )


def field_of(geometry: AcquisitionGeometry, view: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The corner of the detector before pixel [0, 0] and its two edges as vectors, mm: the beam is collimated to it."""
    detector = geometry.detector
    origin, row = geometry.detector_frame(view)
    rows = row * detector.ny * detector.pixel
    columns = geometry.column_direction(view) * detector.nx * detector.pixel
    return origin - rows / 2, rows, columns


def area_of(geometry: AcquisitionGeometry) -> float:
    """mm^2 of the detector."""
    detector = geometry.detector
    return detector.ny * detector.nx * detector.pixel**2


def _vector(values: FloatArray) -> Vector:
    return np.array(values, np.float64)
