"""Newton's method for one load step, and the load steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from simcore.core.errors import SolverError
from simcore.core.progress import Progress, silent
from simcore.fem.assembly import assemble, volume_ratios
from simcore.fem.contact import FREE, MAX_PULL, Contact, Plates
from simcore.fem.linear import Guard, Tangent
from simcore.fem.model import Floats, Model

MAX_NEWTON = 30
GAP_MM = 1e-6
SMALLEST_VOLUME_STEP = 0.3
"""An iteration may not shrink an element below this share of its present volume."""
SHORTEST_STEP = 1e-3
SMALLEST_LOAD_STEP = 0.2
"""Percent of the uncompressed thickness."""
_FIRST_CG_TOLERANCE = 1e-2
_LAST_CG_TOLERANCE = 1e-4
_EXACT_FROM = 6
"""Contact nodes that still come and go by this iteration are kept in motion by inexact linear solutions."""


@dataclass(frozen=True, eq=False)
class State:
    """displacement: (n, 3), mm. pressure: (n,), N/mm^2, positive in tension."""

    displacement: Floats
    pressure: Floats
    contact: Contact


@dataclass(frozen=True, eq=False)
class LoadStep:
    """A converged load step. force_lower, force_upper: on the plates, N; residual: relative to them."""

    percent: float
    force_lower: float
    force_upper: float
    residual: float
    newton_iterations: int


@dataclass
class Counters:
    newton: int = 0
    cg: int = 0


@dataclass(frozen=True, eq=False)
class Solution:
    """The last state, the load steps that led to it, and what they took."""

    state: State
    steps: list[LoadStep]
    counters: Counters


class _StepFailed(Exception):
    """code: what a SolverError would carry if there were no shorter load step to try."""

    def __init__(self, code: str) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True, eq=False)
class Solver:
    """Equilibrium of ``model`` with ``fixed`` degrees of freedom between plates.

    fixed: bool (n, 3), degrees of freedom that keep their displacement.
    tolerance: residual force relative to the plate force (where there is none, to the support force).
    """

    model: Model
    fixed: NDArray[np.bool_]
    guard: Guard
    tolerance: float
    counters: Counters = field(default_factory=Counters)

    def compress(self, contact: Contact, percent: float, load_steps: int, progress: Progress = silent) -> Solution:
        """From rest to ``percent`` of compression along z; a load step that fails is halved.

        raises: SolverError
        """
        n = len(self.model.nodes)
        state = State(np.zeros((n, 3)), np.zeros(n), contact)
        steps: list[LoadStep] = []
        first = percent / load_steps
        reached, size = 0.0, first
        while reached < percent * (1 - 1e-9):
            size = min(size, percent - reached)
            target = percent if reached + size > percent * (1 - 1e-9) else reached + size
            report = _newton_progress(progress, reached / percent, target / percent)
            try:
                state, step = self.load_step(state, Plates.at(self.model.nodes[:, 2], target), report)
            except _StepFailed as failure:
                size /= 2
                if size < SMALLEST_LOAD_STEP * min(1.0, percent):
                    raise _advice(failure.code, reached, percent) from None
                continue
            steps.append(replace(step, percent=target))
            reached, size = target, min(2 * size, first)
        return Solution(state, steps, self.counters)

    def load_step(
        self, state: State, plates: Plates, report: Callable[[int, float], None] = lambda iteration, residual: None
    ) -> tuple[State, LoadStep]:
        """Newton's method with the plates at rest. raises: _StepFailed"""
        model = self.model
        n, blocks = len(model.nodes), len(model.pattern.column)
        force, node_volume = np.empty((n, 3)), np.empty(n)
        stiffness, upper, lower = np.empty((blocks, 3, 3)), np.empty((blocks, 3)), np.empty((blocks, 3))
        u, p, contact = state.displacement, state.pressure, state.contact.new_load_step()
        for iteration in range(MAX_NEWTON):
            smallest = assemble(
                u, p, model.tets, model.gradients, model.volumes, model.parameters, model.pattern.block_of,
                True, force, node_volume, stiffness, upper, lower,
            )  # fmt: skip
            if not smallest > 0:
                raise _StepFailed("inverted-element")
            wanted, compliance = model.volume_ratio_of_pressure(p)
            volume_residual = node_volume - model.node_volume * wanted
            z = model.nodes[:, 2] + u[:, 2]
            old_status = contact.status
            contact = contact.updated(z, force[:, 2], plates, may_release=iteration > 0)
            changes = np.count_nonzero(contact.status != old_status)
            gap = contact.gap(z, plates)
            free = ~self.fixed
            free[contact.status != FREE, 2] = False
            residual = self.relative_residual(force, free, contact)
            report(iteration, residual)
            if (
                iteration > 0
                and changes == 0
                and residual < self.tolerance
                and np.abs(gap).max() < GAP_MM
                and np.abs(volume_residual / model.node_volume).max() < 10 * self.tolerance
            ):
                if contact.relative_pull(force[:, 2]) > MAX_PULL:
                    contact = contact.new_load_step()
                    continue
                low, high = contact.forces(force[:, 2])
                return State(u, p, contact), LoadStep(np.nan, low, high, residual, iteration)
            tangent = Tangent(
                model.pattern, stiffness.astype(np.float32), upper.astype(np.float32), lower.astype(np.float32),
                1 / (model.node_volume * compliance),
            )  # fmt: skip
            du, dp = self._direction(tangent, force, volume_residual, free, gap, self._forcing(iteration, residual))
            length = self._step_length(u, du)
            u, p = u + length * du, p + length * dp
            self.counters.newton += 1
        raise _StepFailed("not-converged")

    def relative_residual(self, force: Floats, free: NDArray[np.bool_], contact: Contact) -> float:
        """Norm of the out-of-balance force over the larger plate force, or over the support force without plates."""
        unbalanced = force * free
        self.guard.project(unbalanced)
        scale = max(*contact.forces(force[:, 2]), 0.0)
        if not (contact.status != FREE).any():
            scale = float(np.linalg.norm(force[self.fixed]))
        return float(np.linalg.norm(unbalanced)) / max(scale, 1e-12)

    def _forcing(self, iteration: int, residual: float) -> float:
        """How exactly to solve the linear system: no better than the next iteration can use."""
        if iteration < 2:
            return _FIRST_CG_TOLERANCE
        if iteration >= _EXACT_FROM:
            return _LAST_CG_TOLERANCE
        return min(_FIRST_CG_TOLERANCE, max(0.1 * self.tolerance / residual, _LAST_CG_TOLERANCE))

    def _direction(
        self,
        tangent: Tangent,
        force: Floats,
        volume_residual: Floats,
        free: NDArray[np.bool_],
        gap: Floats,
        cg_tolerance: float,
    ) -> tuple[Floats, Floats]:
        """Newton's (du, dp): contact nodes go onto their plates, the pressure is condensed node by node."""
        prescribed = np.zeros_like(force)
        prescribed[:, 2] = gap
        pressure_part = tangent.compliance * volume_residual
        rhs = -force - tangent.apply(prescribed)[0] - tangent.apply_coupling(pressure_part)
        solved, iterations = tangent.solve(rhs, free, self.guard, cg_tolerance)
        self.counters.cg += iterations
        du = solved + prescribed
        return du, tangent.apply(du)[1] + pressure_part

    def _step_length(self, u: Floats, du: Floats) -> float:
        """The longest of 1, 0.6, 0.36, ... that leaves every element its share of volume. raises: _StepFailed"""
        tets, gradients = self.model.tets, self.model.gradients
        smallest = SMALLEST_VOLUME_STEP * volume_ratios(u, tets, gradients)
        length = 1.0
        while not (volume_ratios(u + length * du, tets, gradients) >= smallest).all():
            length *= 0.6
            if length < SHORTEST_STEP:
                raise _StepFailed("inverted-element")
        return length


def _newton_progress(progress: Progress, start: float, stop: float) -> Callable[[int, float], None]:
    def report(iteration: int, residual: float) -> None:
        fraction = start + (stop - start) * (1 - 0.75**iteration)
        progress(fraction, f"Newton iteration {iteration}, residual {residual:.1e}")

    return report


def _advice(code: str, reached: float, percent: float) -> SolverError:
    what = {
        "inverted-element": "an element would turn inside out",
        "not-converged": f"Newton's method did not converge within {MAX_NEWTON} iterations",
    }[code]
    return SolverError(
        f"compression by {percent:g} % failed beyond {reached:.3g} %: {what}, however short the load step; ask for a "
        "smaller percent, more load_steps, a finer mesh or a smaller poissons_ratio",
        code=code,
    )
