"""How the kernels of this room are compiled."""

from __future__ import annotations

from simcore.kernels import njit

inner = njit(fastmath=True, _nrt=False)
"""Functions of one photon. They allocate nothing, so arrays are not counted when they are handed on: counting took half
of the time. They are not inlined by numba, which loses what they write into arrays of a NamedTuple."""

outer = njit(parallel=True, cache=True, fastmath=True, error_model="numpy")
"""Loops over blocks or rows."""
