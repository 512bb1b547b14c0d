"""Resampling of image rows at evenly spaced positions with vector instructions and no gathers.

Sixteen neighbouring positions with a step near one pixel read a window of few more than sixteen pixels. Position
l of a window that starts at pixel s lies at p + l d from s + l (d = step - 1, small), so

    value[l] = sum over t of hat(p + l d - t) row[s + l + t],   hat(x) = max(0, 1 - |x| / reach),

where each term is one contiguous load. Linear interpolation (reach = 1) has two terms that are not zero; the others
cost less than sixteen scattered loads, and the weights serve eight rows. numba has no vector types, hence the LLVM
instructions written out below; LLVM lowers them to whatever width the processor has.

The transpose of linear interpolation at positions a + i b is the same sum, with positions (i - a) / b and reach 1 / b.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.core.types import UniTuple  # type: ignore[attr-defined]
from numba.extending import intrinsic
from numpy.typing import NDArray

from simcore.core.vectors import LANES, VECTOR, splat

FloatArray = NDArray[np.float32]

ROWS = 8
"""Rows resampled together."""

MIXED = 4
"""Rows that ``mix_vectors`` takes."""

_INDEX = ir.IntType(64)
_FLOAT = ir.FloatType()


def padded_width(count: int) -> int:
    """``count`` rounded up to whole vectors: the width that ``add_resampled_rows`` fills."""
    return -(-count // LANES) * LANES


def padding(step: float, reach: float = 1.0) -> int:
    """Zeros needed before and after a row that is read with steps of up to ``step`` pixels."""
    return LANES * int(np.ceil(max(step, 1.0))) + 2 * int(np.ceil(reach)) + 2


@njit(cache=True, error_model="numpy")
def add_resampled_rows(
    rows: FloatArray, pad: int, offset: float, step: float, reach: float, totals: FloatArray
) -> None:
    """totals[r, i] += row r weighted with a hat around the position offset + i step; zero beyond the row's ends.

    rows: (ROWS, pad + columns + pad), C order, zero in the padding; pad: ``padding(step, reach)`` or more.
    offset, step: in pixels, 0 is the centre of the first of the ``columns`` pixels; step > 0.
    reach: where the hat is zero, pixels; 1 for linear interpolation.
    totals: (ROWS, padded_width(n)), C order.
    """
    columns = rows.shape[1] - 2 * pad
    drift = (LANES - 1) * (step - 1.0)
    for start in range(0, totals.shape[1], LANES):
        position = offset + start * step
        if position >= columns - 1 + reach or position + (LANES - 1) * step <= -reach:
            continue
        window = int(np.floor(position + min(drift, 0.0) - reach)) + 1
        first = position - window
        taps = int(max(first, first + drift) + reach) + 1
        _add_window(
            rows,
            window + pad,
            totals,
            start,
            np.float32(first),
            np.float32(step - 1.0),
            np.float32(1.0 / reach),
            taps,
        )


@intrinsic  # type: ignore[untyped-decorator]
def mix_vectors(
    typing: Any, source: Any, places: Any, weights: Any, target: Any, place: Any, kept: Any
) -> tuple[Any, Any]:
    """target[place + l] = kept target[place + l] + sum over n < 4 of weights[n] source[places[n] + l], l < 16.

    source, target: float32 (n,), C order. places: four int64. weights: four float32. kept: float32."""
    signature = types.void(
        source,
        UniTuple(types.int64, MIXED),
        UniTuple(types.float32, MIXED),
        target,
        types.int64,
        types.float32,
    )

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source_value, places, weights, target_value, place, kept = arguments
        function = ir.FunctionType(VECTOR, [VECTOR] * 3)
        multiply_add = cgutils.get_or_insert_function(builder.module, function, f"llvm.fmuladd.v{LANES}f32")

        def address(kind: Any, value: Any, at: Any) -> Any:
            data = context.make_array(kind)(context, builder, value).data
            return builder.bitcast(builder.gep(data, [at]), VECTOR.as_pointer())

        goal = address(signature.args[3], target_value, place)
        total = builder.fmul(splat(builder, kept), builder.load(goal, align=4))
        for n in range(MIXED):
            vector = builder.load(address(signature.args[0], source_value, builder.extract_value(places, n)), align=4)
            total = builder.call(multiply_add, [splat(builder, builder.extract_value(weights, n)), vector, total])
        builder.store(total, goal, align=4)
        return context.get_dummy_value()

    return signature, generate


@intrinsic  # type: ignore[untyped-decorator]
def _add_window(
    typing: Any,
    rows: Any,
    window: Any,
    totals: Any,
    start: Any,
    first: Any,
    drift: Any,
    slope: Any,
    taps: Any,
) -> tuple[Any, Any]:
    """totals[r, start + l] += sum over t < taps of hat(first + l drift - t) rows[r, window + l + t], l < 16, r < 8;
    hat(x) = max(0, 1 - slope |x|)."""
    signature = types.void(
        rows, types.int64, totals, types.int64, types.float32, types.float32, types.float32, types.int64
    )

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rows_value, window, totals_value, start, first, drift, slope, taps = arguments
        read = _Rows(context, builder, signature.args[0], rows_value, window)
        write = _Rows(context, builder, signature.args[2], totals_value, start)
        function = ir.FunctionType(VECTOR, [VECTOR])
        absolute = cgutils.get_or_insert_function(builder.module, function, f"llvm.fabs.v{LANES}f32")
        function = ir.FunctionType(VECTOR, [VECTOR] * 2)
        largest = cgutils.get_or_insert_function(builder.module, function, f"llvm.maxnum.v{LANES}f32")
        function = ir.FunctionType(VECTOR, [VECTOR] * 3)
        multiply_add = cgutils.get_or_insert_function(builder.module, function, f"llvm.fmuladd.v{LANES}f32")

        lane = ir.Constant(VECTOR, [float(n) for n in range(LANES)])
        zero, one = (ir.Constant(VECTOR, [value] * LANES) for value in (0.0, 1.0))
        position = builder.call(multiply_add, [lane, splat(builder, drift), splat(builder, first)])
        falling = builder.fneg(splat(builder, slope))
        # LLVM keeps these in registers.
        sums = [cgutils.alloca_once_value(builder, write.load(row, _INDEX(0))) for row in range(ROWS)]
        with cgutils.for_range(builder, taps) as loop:
            tap = splat(builder, builder.sitofp(loop.index, _FLOAT))
            distance = builder.call(absolute, [builder.fsub(position, tap)])
            hat = builder.call(largest, [zero, builder.call(multiply_add, [distance, falling, one])])
            for row in range(ROWS):
                total = builder.call(multiply_add, [hat, read.load(row, loop.index), builder.load(sums[row])])
                builder.store(total, sums[row])
        for row in range(ROWS):
            write.store(row, builder.load(sums[row]))
        return context.get_dummy_value()

    return signature, generate


class _Rows:
    """Vectors in the rows of a C-ordered float32 matrix, from one column on."""

    def __init__(self, context: Any, builder: Any, kind: Any, value: Any, column: Any) -> None:
        matrix = context.make_array(kind)(context, builder, value)
        self.builder = builder
        self.data = matrix.data
        width = builder.extract_value(matrix.shape, 1)
        self.starts = [builder.add(column, builder.mul(width, _INDEX(row))) for row in range(ROWS)]

    def _pointer(self, row: int, shift: Any) -> Any:
        address = self.builder.gep(self.data, [self.builder.add(self.starts[row], shift)])
        return self.builder.bitcast(address, VECTOR.as_pointer())

    def load(self, row: int, shift: Any) -> Any:
        return self.builder.load(self._pointer(row, shift), align=4)

    def store(self, row: int, vector: Any) -> None:
        self.builder.store(vector, self._pointer(row, _INDEX(0)), align=4)
