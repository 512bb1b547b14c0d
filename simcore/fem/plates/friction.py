"""Coulomb friction of skin on the plates, regularised by a small elastic slip.

Every node on a plate carries an elastic slip e (its tangential displacement against the plate, cut to the length
STICK_MM): it resists with coefficient * push * e / STICK_MM. So the full coefficient * push acts against the direction
of sliding, and a node that sticks creeps by less than STICK_MM. The tangent keeps the push of the last iteration.

Source: Wriggers, Computational Contact Mechanics (2006), section 5.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simcore.fem.elements.model import Floats
from simcore.fem.plates.contact import FREE, LOWER, UPPER, Contact, Plates

STICK_MM = 0.05


@dataclass(frozen=True, eq=False)
class Slip:
    """elastic: (n, 3), mm, 0 where a node is free. length: (n,) before it was cut, mm: sliding beyond STICK_MM."""

    elastic: Floats
    length: Floats


@dataclass(frozen=True)
class Friction:
    """coefficient: of Coulomb."""

    coefficient: float

    def slip(self, before: Floats, moved: Floats, contact: Contact, plates: Plates, was: Plates) -> Slip:
        """Elastic slip now.

        before: (n, 3) elastic slip of the last equilibrium, with the plates as they ``was``; moved: (n, 3)
        displacement since, mm.
        """
        trial = before + moved
        trial[:, 2] -= np.where(contact.status == UPPER, plates.upper - was.upper, 0.0)
        trial[:, 2] -= np.where(contact.status == LOWER, plates.lower - was.lower, 0.0)
        trial -= self._along_normal(trial, contact, plates)
        trial[contact.status == FREE] = 0.0
        length = np.linalg.norm(trial, axis=1)
        sliding = length > STICK_MM
        trial[sliding] *= (STICK_MM / length[sliding])[:, None]
        return Slip(trial, length)

    def resistance(self, slip: Slip, push: Floats) -> Floats:
        """(n, 3) force that friction takes from the body, N, as an internal force. push: (n,), N."""
        return (self.coefficient / STICK_MM * np.maximum(push, 0.0))[:, None] * slip.elastic

    def stiffness(
        self, slip: Slip, push: Floats, contact: Contact, plates: Plates, along: float
    ) -> tuple[NDArray[np.int64], Floats]:
        """(nodes on a plate (k,), d resistance / d displacement (k, 3, 3), N/mm).

        along: stiffness of a sliding node along its way, as a share of the secant. The derivative is 0, with which
        nodes change between sticking and sliding without end; 1 majorises the energy, so that each iteration lowers it.
        """
        nodes = np.flatnonzero(contact.status != FREE)
        normals = np.where((contact.status[nodes] == UPPER)[:, None], plates.upper_normal, [0.0, 0.0, 1.0])
        tangential = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        size = self.coefficient * np.maximum(push[nodes], 0.0) / STICK_MM
        direction = slip.elastic[nodes] / STICK_MM
        across = tangential - (1 - along) * direction[:, :, None] * direction[:, None, :]
        length = slip.length[nodes][:, None, None]
        blocks = np.where(length > STICK_MM, across * STICK_MM / np.maximum(length, STICK_MM), tangential)
        return nodes, size[:, None, None] * blocks

    @staticmethod
    def _along_normal(v: Floats, contact: Contact, plates: Plates) -> Floats:
        normals = np.where((contact.status == UPPER)[:, None], plates.upper_normal, [0.0, 0.0, 1.0])
        along: Floats = normals * (v * normals).sum(axis=1, keepdims=True)
        return along
