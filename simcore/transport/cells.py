"""From fine labels to cells of about 1 mm: every cell is a hand of fifteen labels, drawn by the shares of its volume.

A point in a cell has the material of one card of the hand, drawn anew for each point: on average that is the mixture of
the cell, with every tissue's own composition, and what is deposited there belongs to a tissue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.core.grid import Grid, Point
from simcore.kernels import njit, prange
from simcore.transport import draws
from simcore.transport.compiled import inner, outer

CARDS = 15
"""Labels of a hand: with so many, the count of each of sixteen labels takes four bits of a word."""
LABELS = 16
MAX_HANDS = 65535
TABLE_BITS = 18
ROUNDING = 1e-6
FIRST_HAND_KEY = np.uint64(0x2545F4914F6CDD1D)


@dataclass(frozen=True, eq=False)
class Cells:
    """The volume that photons see.

    index: uint16 (cz, cy, cx), which hand a cell has.
    hands: uint8 (hands, CARDS), labels in ascending order.
    corner, edge: (x, y, z) of the outer corner of cell [0, 0, 0] and the edges of a cell, mm.
    upper: (x, y, z), mm: where the labels end; the last cells may reach beyond.
    """

    index: NDArray[np.uint16]
    hands: NDArray[np.uint8]
    corner: Point
    edge: Point
    upper: Point

    def volumes(self) -> NDArray[np.float64]:
        """Volume of every label, mm^3 (LABELS,), as the hands have it."""
        inside = [
            np.minimum(self.corner[axis] + (np.arange(count) + 1) * self.edge[axis], self.upper[axis])
            - (self.corner[axis] + np.arange(count) * self.edge[axis])
            for axis, count in enumerate(self.index.shape[::-1])
        ]
        weights = inside[2][:, None, None] * inside[1][:, None] * inside[0]
        of_hands = np.bincount(self.index.ravel(), weights.ravel(), len(self.hands))
        return of_hands @ self.shares()

    def layer_volumes(self) -> NDArray[np.float64]:
        """Volume of every label in every layer of cells, mm^3 (cz, LABELS)."""
        layers = []
        for layer in range(self.index.shape[0]):
            low = self.corner[2] + layer * self.edge[2]
            high = min(low + self.edge[2], self.upper[2])
            corner, upper = (*self.corner[:2], low), (*self.upper[:2], high)
            layers.append(Cells(self.index[layer : layer + 1], self.hands, corner, self.edge, upper).volumes())
        return np.stack(layers)

    def shares(self) -> NDArray[np.float64]:
        """Share of every label in every hand, (hands, LABELS)."""
        return np.stack([np.bincount(hand, minlength=LABELS) for hand in self.hands]) / CARDS


def cells_of(labels: NDArray[np.uint8], grid: Grid, becomes: NDArray[np.float64], edge_mm: float) -> Cells:
    """Cells of whole voxels, edges near ``edge_mm``.

    becomes: (LABELS, LABELS), share of each label that a label of the volume is taken for; rows sum to 1.
    raises: ValueError for more different hands than MAX_HANDS (cannot happen with the tissues of a breast).
    """
    per_cell = tuple(max(1, round(edge_mm / spacing)) for spacing in grid.spacing[::-1])
    counts = tuple(-(-n // per) for n, per in zip(grid.shape, per_cell, strict=True))
    codes = np.empty(counts, np.uint64)
    _deal(labels, per_cell, np.cumsum(becomes, axis=1), codes)
    index, of_hands, hands = _numbered(codes.ravel())
    if hands > MAX_HANDS:
        raise ValueError(f"{hands} different mixtures of tissues in the cells; at most {MAX_HANDS}")
    return Cells(
        index=index.reshape(counts),
        hands=np.stack([_hand(int(code)) for code in of_hands[:hands]]),
        corner=grid.corner,
        edge=tuple(n * s for n, s in zip(per_cell[::-1], grid.spacing, strict=True)),  # type: ignore[arg-type]
        upper=grid.upper,
    )


def _hand(code: int) -> NDArray[np.uint8]:
    counts = [(code >> (4 * label)) & 15 for label in range(LABELS)]
    return np.repeat(np.arange(LABELS, dtype=np.uint8), counts)


@outer
def _deal(
    labels: NDArray[np.uint8],
    per_cell: tuple[int, int, int],
    becomes: NDArray[np.float64],
    codes: NDArray[np.uint64],
) -> None:
    """Systematic sampling: card c of a hand is the label at (c + u) / CARDS of the shares one behind another, u drawn
    for each cell, so that every label is expected as often as it is there."""
    cz, cy, cx = codes.shape
    nz, ny, nx = labels.shape
    for k in prange(cz):
        counts = np.empty((cx, LABELS), np.int64)
        for j in range(cy):
            counts[:] = 0
            for z in range(k * per_cell[0], min(nz, (k + 1) * per_cell[0])):
                for y in range(j * per_cell[1], min(ny, (j + 1) * per_cell[1])):
                    for i in range(cx):
                        for x in range(i * per_cell[2], min(nx, (i + 1) * per_cell[2])):
                            counts[i, labels[z, y, x]] += 1
            for i in range(cx):
                state = draws.start(FIRST_HAND_KEY, (k * cy + j) * cx + i)
                state, place = draws.uniform(state)
                codes[k, j, i] = _draw(counts[i], becomes, place)


@inner
def _draw(counts: NDArray[np.int64], becomes: NDArray[np.float64], place: float) -> np.uint64:
    """The code of a hand: four bits a label, how many of its cards have it."""
    share = CARDS / counts.sum()
    code = np.uint64(0)
    passed = 0.0
    before = 0
    for label in range(LABELS):
        passed += _taken_for(counts, becomes, label) * share
        full = passed > CARDS - ROUNDING
        cards = CARDS if full else min(CARDS, max(before, int(np.ceil(passed - place))))
        code |= np.uint64(cards - before) << np.uint64(4 * label)
        before = cards
    return code


@inner
def _taken_for(counts: NDArray[np.int64], becomes: NDArray[np.float64], label: int) -> float:
    total = 0.0
    for source in range(LABELS):
        if counts[source] > 0:
            total += counts[source] * (becomes[source, label] - (becomes[source, label - 1] if label > 0 else 0.0))
    return total


@njit(cache=True)
def _numbered(codes: NDArray[np.uint64]) -> tuple[NDArray[np.uint16], NDArray[np.uint64], int]:
    """Numbers in the order of first sight by an open hash table, the codes of the numbers, and how many there are."""
    mask = (1 << TABLE_BITS) - 1
    slots = np.full(1 << TABLE_BITS, -1, np.int64)
    known = np.empty(MAX_HANDS + 1, np.uint64)
    numbers = np.empty(len(codes), np.uint16)
    count = 0
    for cell in range(len(codes)):
        if cell > 0 and codes[cell] == codes[cell - 1]:
            numbers[cell] = numbers[cell - 1]
            continue
        slot = np.int64(draws.hashed(codes[cell]) >> np.uint64(64 - TABLE_BITS))
        while slots[slot] >= 0 and known[slots[slot]] != codes[cell]:
            slot = (slot + 1) & mask
        if slots[slot] < 0:
            if count > MAX_HANDS - 1:
                return numbers, known, MAX_HANDS + 1
            slots[slot] = count
            known[count] = codes[cell]
            count += 1
        numbers[cell] = slots[slot]
    return numbers, known, count
