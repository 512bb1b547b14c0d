"""Plane prefixes (see ``plane_prefix``) of sixteen detector rows at a time, from the borders between tissues alone.

The differences E_b of two running sums grow only where tissue changes along x, and a voxel row of the breast has about
thirty such borders. And where the detector is at rest, all of its rows have their crossings at the same pixels, columns
and heights. So sixteen rows stand side by side in the lanes of a vector: a border adds to E with the weight of each
row's path in that voxel row, and a crossing takes one vector from E and gives it to one pixel of all sixteen.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from simcore.core.vectors import LANES, VECTOR, splat
from simcore.projection.borders import PLACE_SHIFT
from simcore.projection.crossings import Columns, Crossings, crossings_of

FloatArray = NDArray[np.float32]

Rows = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""As in ``plane_prefix``."""

BorderLists = tuple[NDArray[np.int64], NDArray[np.uint32], FloatArray, int, int, int]
"""start and packed of ``Borders``; how mu falls at a border, see ``Borders.falls``; nz, ny, nx."""

FLATTEST = 0.999
"""Voxel rows that a path may pass in a slice: with less than one it turns once at most."""

_INDEX = ir.IntType(64)


@numba.njit(parallel=True, cache=True, error_model="numpy")
def project_lanes(
    borders: BorderLists,
    rows: Rows,
    columns: Columns,
    order: NDArray[np.int64],
    reach: int,
    source_z: float,
    edge_z: float,
    out: FloatArray,
) -> None:
    """Line integrals of a view whose rows have one stretch and turn into one other voxel row at most in a slice.

    order: of the groups of LANES rows. reach: largest x end of tissue. out: float32 (rows, pixels), overwritten.
    """
    slices = borders[3]
    stretch = rows[2]
    tangent_x = columns[0] / source_z * stretch[0]
    squared = (tangent_x * tangent_x).astype(np.float32)
    crossings = crossings_of(columns, stretch[0], slices, reach)
    last = crossings[4]
    pixels = np.searchsorted(last, reach)  # columns at the top ascend: from here on rays pass beyond the tissue
    for task in numba.prange(len(order)):
        first = order[task] * LANES
        count = min(LANES, len(stretch) - first)
        sums = aligned_zeros(borders[5] + 2)
        image = aligned_zeros(len(last))
        if _run_group(borders, rows, crossings, first, count, sums, image):
            _finish(sums, rows[3], last, squared, edge_z, first, count, pixels, image, out)
        else:
            out[first : first + count] = np.float32(0.0)


@numba.njit(cache=True)
def aligned_zeros(vectors: int) -> FloatArray:
    """float32 (vectors * LANES,), from a cache line on."""
    memory = np.zeros((vectors + 1) * LANES, np.float32)
    shift = (-memory.ctypes.data % 64) // 4
    return memory[shift : shift + vectors * LANES]


@numba.njit(cache=True, error_model="numpy")
def _run_group(
    borders: BorderLists, rows: Rows, crossings: Crossings, first: int, count: int, sums: FloatArray, image: FloatArray
) -> bool:
    """Subtracts E_b(z_b) of every crossing from ``image``, pixel after pixel of LANES rows each; leaves E at the top of
    the volume in ``sums``. False where none of the rows meets a border.

    In a slice E grows linearly along a path that stays in one voxel row, and has a bend where it turns into the next.
    E is brought to the top of the slice first, and crossings go back from there."""
    # Tuples are taken apart here, once: every taking apart counts references.
    start, packed, falls, slices, depth, _ = borders
    event_start, pixel, boundary, fraction, _ = crossings
    bottom_y, top_y, _, _ = rows
    entered, left = aligned_zeros(len(sums) // LANES), aligned_zeros(len(sums) // LANES)
    turn, grown, into, beyond = aligned_zeros(1), aligned_zeros(1), aligned_zeros(1), aligned_zeros(1)
    at, then = np.full(LANES, -1, np.int64), np.full(LANES, -1, np.int64)
    turn[:] = np.float32(1.0)
    farthest = np.uint32(0)
    for k in range(slices):
        lowest, highest, turns = depth, -1, False
        for lane in range(count):
            slope = (top_y[first + lane] - bottom_y[first + lane]) / slices
            enter = bottom_y[first + lane] + slope * k
            column, final = math.floor(enter), math.floor(bottom_y[first + lane] + slope * (k + 1))
            at[lane], then[lane] = column, final
            turn[lane] = 1.0
            if column != final:
                turns = True
                turn[lane] = (max(column, final) - enter) / slope
            lowest, highest = min(lowest, column, final), max(highest, column, final)
        lowest, highest = max(lowest, 0), min(highest, depth - 1)
        for column in range(lowest, highest + 1):
            row = k * depth + column
            if start[row] == start[row + 1]:
                continue
            for lane in range(count):
                into[lane] = at[lane] == column
                beyond[lane] = then[lane] == column and at[lane] != column
                grown[lane] = turn[lane] * into[lane] + (np.float32(1.0) - turn[lane]) * beyond[lane]
            for border in range(np.uint64(start[row]), np.uint64(start[row + 1])):
                place = packed[border] >> np.uint32(PLACE_SHIFT)
                fall = falls[packed[border] & np.uint32(255)]
                _grow(sums, place * LANES, fall, grown)
                _grow(entered, place * LANES, fall, into)
                if turns:
                    _grow(left, place * LANES, fall, beyond)
            farthest = max(farthest, packed[start[row + 1] - 1] >> np.uint32(PLACE_SHIFT))
        if farthest == 0:
            continue
        for event in range(np.uint64(event_start[k]), np.uint64(event_start[k + 1])):
            b = boundary[event]
            if b > farthest:
                break
            if turns:
                _cross_turning(image, pixel[event] * LANES, sums, b * LANES, entered, left, fraction[event], turn)
            else:
                _cross(image, pixel[event] * LANES, sums, b * LANES, entered, fraction[event] - np.float32(1.0))
        for column in range(lowest, highest + 1):
            row = k * depth + column
            for border in range(np.uint64(start[row]), np.uint64(start[row + 1])):
                place = packed[border] >> np.uint32(PLACE_SHIFT)
                _clear(entered, place * LANES)
                if turns:
                    _clear(left, place * LANES)
    return bool(farthest > 0)


@numba.njit(cache=True, error_model="numpy")
def _finish(
    sums: FloatArray,
    tangent_y: NDArray[np.float64],
    last: NDArray[np.int32],
    squared: FloatArray,
    edge_z: float,
    first: int,
    count: int,
    pixels: int,
    image: FloatArray,
    out: FloatArray,
) -> None:
    """T at the top of the volume is added, and all multiplied with the length of the ray in one slice.

    squared: (pixels,), (dx / dz)^2."""
    # T_{b-1} = E_b + T_b, and nothing lies beyond the last column: E becomes T.
    for b in range(len(sums) // LANES - 2, -1, -1):
        _grow_by(sums, b * LANES, sums, (b + 1) * LANES)
    constant = (1.0 + tangent_y[first : first + count] ** 2).astype(np.float32)
    edge = np.float32(edge_z)
    for v in range(pixels):
        if last[v] >= 0:
            _grow_by(image, v * LANES, sums, (last[v] + 1) * LANES)
        for lane in range(count):
            out[first + lane, v] = image[v * LANES + lane] * (edge * np.sqrt(constant[lane] + squared[v]))
    out[first : first + count, pixels:] = np.float32(0.0)


def _address(context: Any, builder: Any, kind: Any, array: Any, place: Any) -> Any:
    """Of the vector at ``place`` of a contiguous float32 array."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [place]), VECTOR.as_pointer())


def _function(builder: Any, name: str, count: int) -> Any:
    name = f"llvm.{name}.v{LANES}f32"
    kind = ir.FunctionType(VECTOR, [VECTOR] * count)
    return builder.module.globals.get(name) or ir.Function(builder.module, kind, name)


@intrinsic  # type: ignore[untyped-decorator]
def _grow(typing: Any, target: Any, place: Any, value: Any, weights: Any) -> tuple[Any, Any]:
    """target[place : place + LANES] += value weights"""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target_, place, value, weights_ = arguments
        address = _address(context, builder, signature.args[0], target_, place)
        weight = builder.load(_address(context, builder, signature.args[3], weights_, _INDEX(0)), align=64)
        multiply_add = _function(builder, "fmuladd", 3)
        builder.store(
            builder.call(multiply_add, [splat(builder, value), weight, builder.load(address, align=64)]),
            address,
            align=64,
        )
        return context.get_dummy_value()

    return types.void(target, types.int64, types.float32, weights), generate


@intrinsic  # type: ignore[untyped-decorator]
def _grow_by(typing: Any, target: Any, place: Any, source: Any, start: Any) -> tuple[Any, Any]:
    """target[place : place + LANES] += source[start : start + LANES]"""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target_, place, source_, start = arguments
        address = _address(context, builder, signature.args[0], target_, place)
        other = _address(context, builder, signature.args[2], source_, start)
        builder.store(builder.fadd(builder.load(address, align=64), builder.load(other, align=64)), address, align=64)
        return context.get_dummy_value()

    return types.void(target, types.int64, source, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def _clear(typing: Any, target: Any, place: Any) -> tuple[Any, Any]:
    """target[place : place + LANES] = 0"""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target_, place = arguments
        address = _address(context, builder, signature.args[0], target_, place)
        builder.store(ir.Constant(VECTOR, [0.0] * LANES), address, align=64)
        return context.get_dummy_value()

    return types.void(target, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def _cross(typing: Any, image: Any, v: Any, sums: Any, b: Any, step: Any, part: Any) -> tuple[Any, Any]:
    """image[v : v + LANES] -= sums[b : b + LANES] + part step[b : b + LANES]"""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image_, v, sums_, b, step_, part = arguments
        address = _address(context, builder, signature.args[0], image_, v)
        total = builder.load(_address(context, builder, signature.args[2], sums_, b), align=64)
        grown = builder.load(_address(context, builder, signature.args[4], step_, b), align=64)
        total = builder.call(_function(builder, "fmuladd", 3), [splat(builder, part), grown, total])
        builder.store(builder.fsub(builder.load(address, align=64), total), address, align=64)
        return context.get_dummy_value()

    return types.void(image, types.int64, sums, types.int64, step, types.float32), generate


@intrinsic  # type: ignore[untyped-decorator]
def _cross_turning(
    typing: Any, image: Any, v: Any, sums: Any, b: Any, entered: Any, left: Any, fraction: Any, turn: Any
) -> tuple[Any, Any]:
    """As ``_cross``, where each path leaves one voxel row for the next at its height ``turn`` within the slice (1: it
    does not)."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        image_, v, sums_, b, entered_, left_, fraction, turn_ = arguments
        multiply_add = _function(builder, "fmuladd", 3)
        address = _address(context, builder, signature.args[0], image_, v)
        total, before_turn, after_turn, turn = (
            builder.load(_address(context, builder, signature.args[n], array, place), align=64)
            for n, array, place in ((2, sums_, b), (4, entered_, b), (5, left_, b), (7, turn_, _INDEX(0)))
        )
        height = splat(builder, fraction)
        before = builder.call(_function(builder, "minnum", 2), [height, turn])
        missing = builder.fsub(before, turn)  # of the part up to the turn, at most 0
        after = builder.fsub(builder.fsub(height, before), builder.fsub(ir.Constant(VECTOR, [1.0] * LANES), turn))
        total = builder.call(multiply_add, [missing, before_turn, total])
        total = builder.call(multiply_add, [after, after_turn, total])
        builder.store(builder.fsub(builder.load(address, align=64), total), address, align=64)
        return context.get_dummy_value()

    return types.void(image, types.int64, sums, types.int64, entered, left, types.float32, turn), generate
