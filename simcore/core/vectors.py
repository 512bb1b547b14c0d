"""Vectors of sixteen single-precision numbers for kernels that write their instructions out: numba has none."""

from __future__ import annotations

from typing import Any

from llvmlite import ir

LANES = 16
VECTOR = ir.VectorType(ir.FloatType(), LANES)


def splat(builder: Any, scalar: Any) -> Any:
    """The vector with ``scalar`` in every lane."""
    undefined = ir.Constant(VECTOR, ir.Undefined)
    single = builder.insert_element(undefined, scalar, ir.IntType(32)(0))
    return builder.shuffle_vector(single, undefined, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))
