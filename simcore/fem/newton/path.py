"""The way of the plates: load steps towards a percentage or a force."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from simcore.core.progress import Progress, silent
from simcore.fem.elements.strain import principal_stretches
from simcore.fem.linear.tangent import MAX_ITERATIONS
from simcore.fem.newton import solver as newton
from simcore.fem.newton.outcome import CompressionFailed, message
from simcore.fem.newton.press import MAX_ROUNDS, Press, RigidPress
from simcore.fem.newton.solver import Counters, LoadStep, Solver, State, StepFailed
from simcore.fem.plates.contact import Contact
from simcore.fem.spec import CompressionSpec

SMALLEST_LOAD_STEP = 0.2
"""Percent of the uncompressed thickness."""
FORCE_TOLERANCE = 1e-3
"""Relative difference of the reached from the wanted force."""
FIRST_FORCE_STEP = 10.0
"""Percent, the first step towards a force."""
_MAX_FORCE_STEPS = 60
"""Beside those of the whole way."""
LOCKED = 30.0
"""Pressure of the plates on the outline of the breast, relative to Young's modulus of the stiffest tissue, that no
law is meant for. At 70 % neo-Hookean tissue gives 0.4."""


@dataclass(frozen=True)
class Target:
    """Where the plates stop.

    percent: compression of the thickness; with ``force`` the most that is allowed on the way to it.
    force: plate force to reach, N. force_limit: plate force that may not be exceeded, N.
    spec: what was asked for: a failure does not advise what it has already.
    """

    percent: float
    force: float | None = None
    force_limit: float | None = None
    spec: CompressionSpec = field(default_factory=CompressionSpec)


@dataclass(frozen=True, eq=False)
class Solution:
    """The last state, the load steps that led to it, and what they took."""

    state: State
    steps: list[LoadStep]
    counters: Counters

    @property
    def force_curve(self) -> list[dict[str, float]]:
        return [{"percent": 0.0, "force_N": 0.0}] + [{"percent": s.percent, "force_N": s.force} for s in self.steps]


def follow(
    solver: Solver,
    contact: Contact,
    target: Target,
    load_steps: int = 1,
    progress: Progress = silent,
    press: Press | None = None,
) -> Solution:
    """From rest to ``target``; a load step that fails is halved. press: rigid, level plates where not given.

    raises: CompressionFailed with the last good state
    """
    path = _Path(solver, press or RigidPress(), State.rest(contact), [], target, progress)
    size = target.percent / load_steps
    if target.force is None:
        path.advance(target.percent, size)
    else:
        path.advance_to_force(target.force, min(size, FIRST_FORCE_STEP), size)
    return path.solution


@dataclass
class _Path:
    solver: Solver
    press: Press
    state: State
    steps: list[LoadStep]
    target: Target
    progress: Progress
    fraction: float = 0.0
    failure: str = "not-converged"

    @property
    def reached(self) -> float:
        return self.steps[-1].percent if self.steps else 0.0

    @property
    def force(self) -> float:
        return self.steps[-1].force if self.steps else 0.0

    @property
    def solution(self) -> Solution:
        return Solution(self.state, self.steps, self.solver.counters)

    def advance(self, percent: float, first: float) -> None:
        """In steps of at most ``first`` percent."""
        size = first
        while self.reached < percent * (1 - 1e-9):
            size = min(size, percent - self.reached)
            goal = percent if self.reached + size > percent * (1 - 1e-9) else self.reached + size
            solved = self._try(goal, goal / percent)
            if solved is None:
                size = self._halved(size)
                continue
            self._accept(*solved)
            size = min(2 * size, first)

    def advance_to_force(self, force: float, first: float, longest: float) -> None:
        """Steps from below, so that the loading is monotone; a state beyond the force only narrows the interval.
        first, longest: of the steps, percent."""
        largest = self.target.percent
        beyond: LoadStep | None = None
        size = first
        most = _MAX_FORCE_STEPS + math.ceil(largest / longest)
        for _ in range(most):
            if abs(self.force - force) <= FORCE_TOLERANCE * force:
                return
            if self.reached >= largest * (1 - 1e-9):
                raise self._failed("target-not-reached", force=self.force, target=force)
            goal = _percent_of_force(self.steps[-1] if self.steps else None, beyond, force, self.reached + size)
            goal = min(goal, largest)
            solved = self._try(goal, min(self.force / force + 0.2, 1.0))
            if solved is None:
                size = self._halved(goal - self.reached)
                continue
            step = solved[1]
            if step.force > force * (1 + FORCE_TOLERANCE):
                beyond = step
            else:
                size = min(max(2 * (step.percent - self.reached), first), longest)
                self._accept(*solved)
        further = beyond or self.steps[-1]
        raise self._failed(
            "force-not-met",
            force=self.force,
            percent=self.reached,
            beyond=further.force,
            further=further.percent,
            target=force,
            steps=most,
        )

    def _try(self, percent: float, fraction: float) -> tuple[State, LoadStep] | None:
        report = _NewtonProgress(self.progress, self.fraction, max(fraction, self.fraction))
        try:
            state, step = self.press.settle(self.solver, self.state, percent, report)
        except StepFailed as failure:
            self.failure = failure.code
            return None
        finally:
            self.fraction = report.fraction
        self._refuse_instability(state)
        return state, replace(step, percent=percent)

    def _accept(self, state: State, step: LoadStep) -> None:
        limit = self.target.force_limit
        if limit is not None and max(step.force_lower, step.force_upper) > limit:
            raise self._failed("force-limit", limit=limit)
        self._refuse_locking(state, step)
        self.state = state
        self.steps.append(step)

    def _halved(self, size: float) -> float:
        if size / 2 >= SMALLEST_LOAD_STEP * min(1.0, self.target.percent):
            return size / 2
        if self.solver.model.laws.least_stretch:
            raise self._failed("unstable-material", stretch=self._least_stretch(self.state))
        raise self._failed(self.failure, iterations=newton.MAX_NEWTON, limit=MAX_ITERATIONS, rounds=MAX_ROUNDS)

    def _refuse_instability(self, state: State) -> None:
        if limit := self.solver.model.laws.least_stretch:
            stretch = self._least_stretch(state)
            if stretch < limit:
                raise self._failed("unstable-material", stretch=stretch)

    def _refuse_locking(self, state: State, step: LoadStep) -> None:
        """The laws are fitted to moderate strains; an exponential one gives any force where an element is squeezed
        against a fixed wall."""
        after = self.solver.model.nodes + state.displacement
        footprint = float(np.ptp(after[:, 0]) * np.ptp(after[:, 1]))
        stiffest = 3 * float(self.solver.model.laws.shear.max())
        if step.force > LOCKED * stiffest * footprint:
            raise self._failed("locked-tissue", pressure=step.force / footprint / stiffest, limit=LOCKED)

    def _least_stretch(self, state: State) -> float:
        model = self.solver.model
        return float(principal_stretches(state.displacement, model.tets, model.gradients).min())

    def _failed(self, code: str, **facts: float) -> CompressionFailed:
        goal = f"{self.target.percent:g} %" if self.target.force is None else f"{self.target.force:g} N"
        return CompressionFailed(
            f"compression to {goal} failed beyond {self.reached:.3g} % ({self.force:.3g} N): "
            + message(code, self.target.spec, **facts),
            code=code,
            percent=self.reached,
            force_N=self.force,
            displacement=np.array(self.state.displacement),
            force_curve=self.solution.force_curve,
        )


def _percent_of_force(below: LoadStep | None, beyond: LoadStep | None, force: float, furthest: float) -> float:
    """Where to look for ``force``: on the power law through the two states, or through the lower one with the exponent
    3/2 of early contact."""
    if below is None or below.force <= 0:
        return furthest if beyond is None else 0.5 * beyond.percent
    if beyond is None:
        return min(below.percent * math.pow(force / below.force, 2 / 3), furthest)
    exponent = math.log(beyond.force / below.force) / math.log(beyond.percent / below.percent)
    guess = below.percent * math.pow(force / below.force, 1 / max(exponent, 0.1))
    margin = 0.02 * (beyond.percent - below.percent)
    return min(max(guess, below.percent + margin), beyond.percent - margin)


class _NewtonProgress:
    """Newton iterations as a fraction of the way between ``start`` and ``stop``; never goes back."""

    def __init__(self, progress: Progress, start: float, stop: float) -> None:
        self.progress, self.start, self.stop, self.fraction = progress, start, stop, start

    def __call__(self, iteration: int, residual: float) -> None:
        self.fraction = self.start + (self.stop - self.start) * (1 - 0.75**iteration)
        self.progress(self.fraction, f"Newton iteration {iteration}, residual {residual:.1e}")
