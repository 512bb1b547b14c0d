"""Newton's method for one load step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simcore.fem.elements.geometry import keeps_volume
from simcore.fem.elements.model import Floats, Model, System
from simcore.fem.linear.tangent import Guard, Tangent, norm
from simcore.fem.plates.constraints import Constraints
from simcore.fem.plates.contact import FREE, MAX_PULL, Contact, Plates
from simcore.fem.plates.friction import Friction, Slip

MAX_NEWTON = 30
GAP_MM = 1e-6
SMALLEST_VOLUME_STEP = 0.3
"""An iteration may not shrink an element below this share of its present volume."""
SHORTEST_STEP = 1e-3
_CG_TOLERANCE = 3e-3
"""How exactly linear systems are solved. At 1e-2 Newton's method takes two or three iterations more, at 1e-3 none
less, but half as many products again."""
_EXACT_CG_TOLERANCE = 1e-4
_STABILITY_TOLERANCE = 1e-3
"""Of the linear system that tries an equilibrium: soft directions are among the last that it finds."""
BOLDEST = 0.15
"""Share of the thickness that a load step may take where the tangent was not positive on the way: Newton's method may
have gone past a bifurcation, and a longer step does not tell."""
LONGEST_WAY = 1.75
"""What a node may move in such a step, relative to the plates: more is a jump to another equilibrium, a breast that
rolls aside. Smooth compressions stay at 1, and below 1.7 with friction."""
SHORTEST_JUMP = 0.01
"""Share of the thickness that nodes may move beyond that: skin that folds snaps by less, however short the step."""
_STALLED = 0.8
"""A residual that does not fall below this share of the last one, with the contact at rest, calls for half a step:
Newton's method can swing to and fro across the kink where skin begins to wrinkle."""
_LEAST_SECANT = 0.01
_EXACT_FROM = 6
"""Contact nodes that still come and go by this iteration are kept in motion by inexact linear solutions."""


@dataclass(frozen=True, eq=False)
class State:
    """displacement: (n, 3), mm. pressure: (n,), N/mm^2, positive in tension. plates: where they stand; none at rest.
    slip: elastic slip of friction; none without it."""

    displacement: Floats
    pressure: Floats
    contact: Contact
    plates: Plates | None = None
    slip: Slip | None = None

    @classmethod
    def rest(cls, contact: Contact) -> State:
        n = len(contact.status)
        return cls(np.zeros((n, 3)), np.zeros(n), contact)


@dataclass(frozen=True, eq=False)
class LoadStep:
    """A converged load step. force_lower, force_upper: on the plates, N; residual: relative to them."""

    percent: float
    force_lower: float
    force_upper: float
    residual: float
    newton_iterations: int

    @property
    def force(self) -> float:
        """Mean of the two plates, N."""
        return 0.5 * (self.force_lower + self.force_upper)


@dataclass
class Counters:
    newton: int = 0
    cg: int = 0


class StepFailed(Exception):
    """code: what a SolverError would carry if there were no shorter load step to try."""

    def __init__(self, code: str) -> None:
        super().__init__(code)
        self.code = code


@dataclass
class _Pace:
    """How bold the next iteration may be.

    stalled: share of the best residual above which the step is halved. length: of the step. secant: share of friction's
    secant, 1 at first and half of the last one wherever the residual falls.
    """

    stalled: float
    length: float = 1.0
    secant: float = 1.0
    best: float = np.inf

    def next(self, residual: float, *, at_rest: bool) -> None:
        """at_rest: whether the contact has not changed in the last iteration."""
        falls = residual < self.best
        self.secant = max(self.secant / 2, _LEAST_SECANT) if at_rest and falls else 1.0
        self.length = 0.5 if at_rest and residual > self.stalled * self.best else 1.0
        self.best = min(self.best, residual) if at_rest else np.inf


@dataclass(frozen=True, eq=False)
class Solver:
    """Equilibrium of ``model`` with ``fixed`` degrees of freedom between plates.

    fixed: bool (n, 3), degrees of freedom that keep their displacement. friction: of skin on the plates.
    tolerance: residual force relative to the plate force (where there is none, to the support force).
    """

    model: Model
    fixed: NDArray[np.bool_]
    guard: Guard
    tolerance: float
    friction: Friction | None = None
    counters: Counters = field(default_factory=Counters)

    def __post_init__(self) -> None:
        object.__setattr__(self, "guard", self.guard.among(~self.fixed[:, 1]))

    def load_step(
        self, state: State, plates: Plates, report: Callable[[int, float], None] = lambda iteration, residual: None
    ) -> tuple[State, LoadStep]:
        """Newton's method with the plates at rest. raises: StepFailed"""
        model = self.model
        system = model.system(single=True)
        force, node_volume = system.force, system.node_volume
        u, p, contact = state.displacement, state.pressure, state.contact.new_load_step()
        slip: Slip | None = None
        wavered = False
        pace = _Pace(_STALLED if self.friction is None else 1.0)
        for iteration in range(MAX_NEWTON):
            if not model.assemble(u, p, system) > 0:
                raise StepFailed("inverted-element")
            ratio, compliance = model.volume_ratio_of_pressure(p)
            volume_residual = node_volume - model.node_volume * ratio
            points = model.nodes + u
            old_status = contact.status
            contact = contact.updated(points, force, plates, may_release=iteration > 0)
            changes = np.count_nonzero(contact.status != old_status)
            gap = contact.gap(points, plates)
            constraints = Constraints.of(self.fixed, contact, plates)
            if self.friction is not None:
                slip = self._add_friction(state, u, contact, plates, system, pace.secant)
            residual = self.relative_residual(force, constraints, contact)
            pace.next(residual, at_rest=changes == 0 and iteration > 0)
            if not np.isfinite(residual):
                raise StepFailed("not-converged")
            report(iteration, residual)
            if (
                iteration > 0
                and changes == 0
                and residual < self.tolerance
                and np.abs(gap).max() < GAP_MM
                and np.abs(volume_residual / model.node_volume).max() < 10 * self.tolerance
            ):
                if contact.relative_pull(force, plates) > MAX_PULL:
                    contact = contact.new_load_step()
                    continue
                self._refuse_instability(self._tangent(system, compliance), constraints)
                if wavered and self._lost_the_path(state, u, plates):
                    raise StepFailed("unstable-equilibrium")
                carried = force if self.friction is None else model.internal_force(u, p)
                low, high = contact.forces(carried[:, 2])
                return State(u, p, contact, plates, slip), LoadStep(np.nan, low, high, residual, iteration)
            tangent = self._tangent(system, compliance)
            exactness = _CG_TOLERANCE if iteration < _EXACT_FROM else _EXACT_CG_TOLERANCE
            du, dp, definite = self._direction(tangent, force, volume_residual, constraints, gap, exactness)
            wavered = wavered or not definite
            length = self._step_length(u, du)
            if length < SHORTEST_STEP:
                raise StepFailed("unstable-equilibrium" if wavered else "inverted-element")
            length *= pace.length
            u, p = u + length * du, p + length * dp
            self.counters.newton += 1
        raise StepFailed("unstable-equilibrium" if wavered else "not-converged")

    def _tangent(self, system: System, compliance: Floats) -> Tangent:
        return Tangent.of(self.model.pattern, system, 1 / (self.model.node_volume * compliance))

    def _refuse_instability(self, tangent: Tangent, constraints: Constraints) -> None:
        """The tangent must be positive along the directions that answer a smooth load without symmetry: a breast that
        would sway or roll is one whose symmetric equilibrium looks well to every symmetric load.

        raises: StepFailed
        """
        nodes = self.model.nodes
        x, y, z = ((nodes - nodes.mean(axis=0)) / np.ptp(nodes, axis=0)).T
        load = self.model.node_volume[:, None] * np.stack([1 + y - z + x * y, 1 + x + z * z - y, x - y + y * z], axis=1)
        solved = tangent.solve(load, constraints, self.guard, _STABILITY_TOLERANCE)
        if not solved.definite:
            raise StepFailed("unstable-equilibrium")
        if not solved.converged:
            raise StepFailed("linear-system")

    def _lost_the_path(self, before: State, u: Floats, plates: Plates) -> bool:
        """Whether a step on whose way the tangent was not positive may have ended on another branch of equilibria."""
        was = before.plates or Plates.at(self.model.nodes[:, 2], 0.0)
        closed = was.upper - was.lower - (plates.upper - plates.lower)
        height = float(np.ptp(self.model.nodes[:, 2]))
        if closed > BOLDEST * height:
            return True
        points = self.model.nodes + u
        travel = max(
            float(np.abs(now - then).max())
            for now, then in zip(plates.heights(points), was.heights(points), strict=True)
        )
        return float(np.abs(u - before.displacement).max()) > LONGEST_WAY * travel + SHORTEST_JUMP * height

    def with_friction(self, state: State, force: Floats) -> Floats:
        """``force`` (n, 3), the internal one less the dead load, and the resistance of friction, N."""
        if self.friction is None or state.slip is None or state.plates is None:
            return force
        return force + self.friction.resistance(state.slip, state.contact.push(force, state.plates))

    def _add_friction(
        self, before: State, u: Floats, contact: Contact, plates: Plates, system: System, secant: float
    ) -> Slip:
        """Friction of the present state, added to the forces and the tangent."""
        assert self.friction is not None
        moved = u - before.displacement
        was = before.plates or Plates.at(self.model.nodes[:, 2], 0.0)
        still = before.slip.elastic if before.slip is not None else np.zeros_like(u)
        slip = self.friction.slip(still, moved, contact, plates, was)
        push = contact.push(system.force, plates)
        system.force[:] += self.friction.resistance(slip, push)
        nodes, blocks = self.friction.stiffness(slip, push, contact, plates, secant)
        system.stiffness[self.model.pattern.row_start[nodes]] += blocks.astype(np.float32)
        return slip

    def relative_residual(self, force: Floats, constraints: Constraints, contact: Contact) -> float:
        """Norm of the out-of-balance force over ``scale``."""
        unbalanced = force.copy()
        constraints.project(unbalanced)
        self.guard.project(unbalanced)
        return norm(unbalanced) / self.scale(force, contact)

    def scale(self, force: Floats, contact: Contact) -> float:
        """What residuals are relative to: the larger plate force, or the support force without plates, N."""
        scale = max(*contact.forces(force[:, 2]), 0.0)
        if not (contact.status != FREE).any():
            scale = norm(force[self.fixed])
        return max(scale, 1e-12)

    def _direction(
        self,
        tangent: Tangent,
        force: Floats,
        volume_residual: Floats,
        constraints: Constraints,
        gap: Floats,
        cg_tolerance: float,
    ) -> tuple[Floats, Floats, bool]:
        """Newton's (du, dp), and whether the tangent was positive: contact nodes go onto their plates, the pressure is
        condensed node by node.

        raises: StepFailed where the linear system is not solved within the limit of iterations
        """
        prescribed = np.zeros_like(force)
        prescribed[:, 2] = gap
        pressure_part = tangent.compliance * volume_residual
        rhs = -force - tangent.apply(prescribed)[0] - tangent.apply_coupling(pressure_part)
        solved = tangent.solve(rhs, constraints, self.guard, cg_tolerance)
        self.counters.cg += solved.iterations
        if solved.definite and not solved.converged:
            raise StepFailed("linear-system")
        du = solved.x + prescribed
        return du, tangent.apply(du)[1] + pressure_part, solved.definite

    def _step_length(self, u: Floats, du: Floats) -> float:
        """The longest of 1, 0.6, 0.36, ... that leaves every element its share of volume; less than SHORTEST_STEP where
        none does."""
        tets, gradients = self.model.tets, self.model.gradients
        length = 1.0
        while length >= SHORTEST_STEP and not keeps_volume(u, du, length, tets, gradients, SMALLEST_VOLUME_STEP):
            length *= 0.6
        return length
