"""What is looked at while a file is surveyed: pieces, lesions, and what its surface is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simcore.core.components import Components
from simcore.core.tissues import MAX_TISSUES, Tissue
from simcore.phantom.upload.lesions import Lesions

COVER = (Tissue.SKIN, Tissue.NIPPLE)


class Anatomy:
    """Blocks of a file are added in their order, as ``decoding.blocks`` gives them.

    body: connected components of all tissue. lesions: those of masses and calcifications.
    surface: voxels of tissue beside one that is none, in a plane across the slowest axis; covered: those of skin.
    body_only: nothing but ``body`` is asked for.
    """

    def __init__(self, shape: tuple[int, int, int], body_only: bool = False) -> None:
        self.body = Components(corners=True, centres=False)
        self.lesions = Lesions()
        self.surface = self.covered = 0
        self._shape, self._body_only = shape, body_only
        self._plane: NDArray[np.uint8] | None = None

    def add(self, row: int, codes: NDArray[np.uint8]) -> None:
        """Entries of a table of tissues (n, rows, columns), from ``row`` on."""
        rows = codes.shape[1]
        if rows == self._shape[1]:
            self._add(codes)
            return
        if self._plane is None:
            self._plane = np.zeros((1, *self._shape[1:]), np.uint8)
        self._plane[:, row : row + rows] = codes
        self._finish(row + rows)

    def skip(self, row: int, planes: int, rows: int) -> None:
        """As ``add`` for a block of air."""
        if rows < self._shape[1]:
            self._finish(row + rows)
            return
        self.body.skip(planes)
        self.lesions.skip(planes)

    def _finish(self, behind: int) -> None:
        if behind < self._shape[1]:
            return
        if self._plane is None:
            self.body.skip(1)
            self.lesions.skip(1)
        else:
            self._add(self._plane)
        self._plane = None

    def _add(self, codes: NDArray[np.uint8]) -> None:
        body = (codes != Tissue.AIR) & (codes < MAX_TISSUES)
        if not body.any():
            self.body.skip(len(codes))
            self.lesions.skip(len(codes))
            return
        self.body.add(body)
        if self._body_only:
            return
        self.lesions.add(codes)
        rows, columns = (_around(body.any(axis=others)) for others in ((0, 2), (0, 1)))
        body, codes = body[:, rows, columns], codes[:, rows, columns]
        beside = np.zeros_like(body)
        for here, there in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[:, :, 1:], np.s_[:, :, :-1])):
            beside[here] |= ~body[there]
            beside[there] |= ~body[here]
        beside &= body
        self.surface += int(np.count_nonzero(beside))
        self.covered += int(np.count_nonzero(np.isin(codes[beside], COVER)))


def _around(any_of: NDArray[np.bool_]) -> slice:
    """From one before the first to one behind the last that is true; there is one."""
    places = np.flatnonzero(any_of)
    return slice(max(0, int(places[0]) - 1), int(places[-1]) + 2)
