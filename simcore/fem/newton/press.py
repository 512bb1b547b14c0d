"""What the plates do while the breast pushes back: nothing, tilt, turn on a spring, or bend; edge: theirs at a fixed
chest wall."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from simcore.fem.elements.model import Floats
from simcore.fem.newton.solver import LoadStep, Solver, State, StepFailed
from simcore.fem.plates.bending import BendingPlate
from simcore.fem.plates.contact import LOWER, UPPER, Plates
from simcore.fem.plates.edge import PlateEdge

Report = Callable[[int, float], None]

MAX_ROUNDS = 40
MOMENT_TOLERANCE = 1e-4
"""Moment on a turning paddle that its spring leaves, relative to the largest one."""
BEND_TOLERANCE_MM = 1e-3
MAX_SLOPE = 0.5


class Press(Protocol):
    """Equilibrium of breast and plates for a travel of ``percent``, from a state with less of it."""

    def settle(self, solver: Solver, state: State, percent: float, report: Report) -> tuple[State, LoadStep]:
        """raises: StepFailed"""
        ...


def _closed(solver: Solver, percent: float, edge: PlateEdge | None, slope: float = 0.0, pivot: float = 0.0) -> Plates:
    plates = Plates.at(solver.model.nodes[:, 2], percent, slope, pivot)
    return plates if edge is None else edge.on(plates)


@dataclass(frozen=True, eq=False)
class RigidPress:
    """Rigid plates. slope: dz/dx of the upper one, which turns about the chest wall, x = 0."""

    slope: float = 0.0
    edge: PlateEdge | None = None

    def settle(self, solver: Solver, state: State, percent: float, report: Report) -> tuple[State, LoadStep]:
        return solver.load_step(state, _closed(solver, percent, self.edge, self.slope), report)


@dataclass(frozen=True, eq=False)
class SpringPress:
    """The upper plate turns about the line x = pivot until its spring holds the moment of the breast.

    stiffness: N mm/rad. pivot: mm; percent is the travel of the plate there.
    """

    stiffness: float
    pivot: float
    edge: PlateEdge | None = None

    def settle(self, solver: Solver, state: State, percent: float, report: Report) -> tuple[State, LoadStep]:
        """The angle at which the moments balance, by the secant method inside a bracket."""
        angle = 0.0 if state.plates is None else float(np.arctan(state.plates.slope))
        below: tuple[float, float] | None = None  # an angle with too little, and one with too much, and what is left
        above: tuple[float, float] | None = None
        last: tuple[float, float] | None = None
        start, now = state, state
        for _ in range(MAX_ROUNDS):
            plates = _closed(solver, percent, self.edge, float(np.tan(angle)), self.pivot)
            now, step = solver.load_step(start if solver.friction is not None else now, plates, report)
            moment, scale = self._moment(solver, now, plates)
            rest = self.stiffness * angle - moment
            if abs(rest) <= MOMENT_TOLERANCE * max(scale, 1e-9):
                return now, step
            below, above = ((angle, rest), above) if rest < 0 else (below, (angle, rest))
            angle, last = self._next(angle, rest, last, below, above), (angle, rest)
            if abs(np.tan(angle)) > MAX_SLOPE:
                raise StepFailed("paddle-turned")
        raise StepFailed("unsettled-plates")

    def _moment(self, solver: Solver, state: State, plates: Plates) -> tuple[float, float]:
        """(moment of the breast on the plate about the pivot, sum of the sizes of its parts), N mm."""
        push = state.contact.push(solver.model.internal_force(state.displacement, state.pressure), plates)
        on = state.contact.status == UPPER
        arm = (solver.model.nodes[on, 0] + state.displacement[on, 0] - plates.pivot) * np.hypot(1.0, plates.slope)
        return float((push[on] * arm).sum()), float(np.abs(push[on] * arm).sum())

    def _next(
        self,
        angle: float,
        rest: float,
        last: tuple[float, float] | None,
        below: tuple[float, float] | None,
        above: tuple[float, float] | None,
    ) -> float:
        # The spring alone is softer than spring and breast: half of its answer to begin with.
        guess = angle - 0.5 * rest / self.stiffness
        guess = angle + float(np.clip(guess - angle, -0.02, 0.02))
        if last is not None and rest != last[1]:
            guess = angle - rest * (angle - last[0]) / (rest - last[1])
            guess = angle + float(np.clip(guess - angle, -0.1, 0.1))
        if below is not None and above is not None:
            low, high = sorted((below[0], above[0]))
            margin = 0.05 * (high - low)
            if not low + margin < guess < high - margin:
                guess = below[0] + (above[0] - below[0]) * below[1] / (below[1] - above[1])
                guess = min(max(guess, low + margin), high - margin)
        return guess


@dataclass(frozen=True, eq=False)
class ElasticPress:
    """Both plates bend; their supported edges move by the travel."""

    plate: BendingPlate
    edge: PlateEdge | None = None

    def settle(self, solver: Solver, state: State, percent: float, report: Report) -> tuple[State, LoadStep]:
        """The deflection that the contact forces keep up, by fixed-point rounds with Aitken's relaxation."""
        rigid = _closed(solver, percent, self.edge)
        n = len(solver.model.nodes)
        bend = np.zeros((2, n))
        if state.plates is not None and state.plates.lower_bend is not None and state.plates.upper_bend is not None:
            bend = np.stack([state.plates.lower_bend, state.plates.upper_bend])
        relaxation, before = 1.0, None
        start, now = state, state
        for _ in range(MAX_ROUNDS):
            plates = replace(rigid, lower_bend=bend[0], upper_bend=bend[1])
            now, step = solver.load_step(start if solver.friction is not None else now, plates, report)
            change = self._bend(solver, now, plates) - bend
            if np.abs(change).max() <= BEND_TOLERANCE_MM:
                return now, step
            if before is not None:
                difference = change - before
                size = float((difference * difference).sum())
                relaxation *= -float((before * difference).sum()) / max(size, 1e-300)
                relaxation = float(np.clip(relaxation, 0.02, 1.5))
            before = change
            bend = bend + relaxation * change
        raise StepFailed("unsettled-plates")

    def _bend(self, solver: Solver, state: State, plates: Plates) -> Floats:
        """(lower, upper) deflection at the nodes under the present forces, (2, n), mm; 0 inside the body."""
        points = solver.model.nodes + state.displacement
        push = state.contact.push(solver.model.internal_force(state.displacement, state.pressure), plates)
        at = state.contact.candidates
        bend = np.zeros((2, len(points)))
        for row, (plate, sign) in enumerate(((LOWER, -1.0), (UPPER, 1.0))):
            on = state.contact.status == plate
            bend[row, at] = sign * self.plate.deflection(points[at], points[on], push[on])
        return bend
