"""One pass over a symmetric matrix: a rank-2 update and a product, in the machine's vector registers.

The matrix is held as its lower triangle of 8 x 8 tiles, one behind the other, row of tiles by row of tiles (tiles on
the diagonal are full).  `update_multiply` adds c0 w0' + c1 w1' to it and takes its product with k; `multiply` only
takes the product.  Each element is loaded once and stored once at most, in the order of memory, which is what a pass
costs: the triangle lives in the second-level cache.

The inner loop is written as LLVM instructions on vectors of eight numbers, because the compiler refuses to vectorise
its plain form for several rows at once (it can't rule out that they overlap) and takes twice as long on one.  Sums
have eight fixed lanes and fused products, so the result is the same on every processor that has fused multiply-add.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from flightstack.jit import njit_called
from flightstack.types import F64

BLOCK = 8
_DOUBLE, _INT = ir.DoubleType(), ir.IntType(64)
_VECTOR = ir.VectorType(_DOUBLE, BLOCK)
_EIGHT = ir.VectorType(ir.IntType(32), BLOCK)
_UNDEFINED = ir.Constant(_VECTOR, ir.Undefined)


def padded(size: int) -> int:
    """The size, rounded up to whole tiles."""
    return -(-size // BLOCK) * BLOCK


def triangle(size: int) -> int:
    """Elements of the triangle of tiles for so many rows."""
    blocks = -(-size // BLOCK)
    return BLOCK * BLOCK * blocks * (blocks + 1) // 2


def aligned(rows: int, columns: int) -> F64:
    """Zeros, (rows, columns), that begin on a cache line."""
    buffer = np.zeros(rows * columns + BLOCK)
    start = -(buffer.ctypes.data // 8) % BLOCK
    return buffer[start : start + rows * columns].reshape(rows, columns)


@njit_called
def update_multiply(matrix: F64, size: int, rank2: F64, k: F64, out: F64) -> None:
    """matrix += c0 w0' + c1 w1', then out = matrix k, over the first `size` rows and columns, whole tiles.

    `rank2` has the rows w0, w1, c0, c1 (and may have more below).
    """
    out[:size] = 0.0
    for row in range(0, size, BLOCK):
        _update_panel(matrix, row, rank2, rank2.shape[1], k, out)


@njit_called
def multiply(matrix: F64, size: int, k: F64, out: F64) -> None:
    """out = matrix k over the first `size` rows and columns, whole tiles."""
    out[:size] = 0.0
    for row in range(0, size, BLOCK):
        _product_panel(matrix, row, k, 0, k, out)


@njit_called
def read_column(matrix: F64, size: int, place: int, out: F64) -> None:
    """One column of the matrix, as long as whole tiles."""
    block, lane = place // BLOCK, place % BLOCK
    for other in range(block + 1):
        start = (block * (block + 1) // 2 + other) * BLOCK * BLOCK + lane * BLOCK
        for i in range(BLOCK):
            out[other * BLOCK + i] = matrix[start + i]
    for other in range(block + 1, size // BLOCK):
        start = (other * (other + 1) // 2 + block) * BLOCK * BLOCK + lane
        for i in range(BLOCK):
            out[other * BLOCK + i] = matrix[start + i * BLOCK]


@njit_called
def write_column(matrix: F64, size: int, place: int, column: F64) -> None:
    """Write one column of the matrix, and its row."""
    block, lane = place // BLOCK, place % BLOCK
    for other in range(block + 1):
        start = (block * (block + 1) // 2 + other) * BLOCK * BLOCK + lane * BLOCK
        for i in range(BLOCK):
            matrix[start + i] = column[other * BLOCK + i]
    for other in range(block, size // BLOCK):
        start = (other * (other + 1) // 2 + block) * BLOCK * BLOCK + lane
        for i in range(BLOCK):
            matrix[start + i * BLOCK] = column[other * BLOCK + i]


class _Emit:
    """Writes the loop over one panel, eight rows of the triangle; final."""

    def __init__(self, builder: Any, pointers: list[Any], update: bool) -> None:
        self.b, self.update = builder, update
        matrix, self.first, self.w0, stride, self.k, self.out = pointers
        self.w1, self.c0, self.c1 = (self.at(self.w0, builder.mul(stride, _int(i))) for i in (1, 2, 3))
        places = [builder.add(self.first, _int(r)) for r in range(BLOCK)]
        block = builder.sdiv(self.first, _int(BLOCK))
        tiles = builder.sdiv(builder.mul(block, builder.add(block, _int(1))), _int(2))  # in the rows of tiles above
        panel = self.at(matrix, builder.mul(tiles, _int(BLOCK * BLOCK)))
        self.rows = [self.at(panel, _int(r * BLOCK)) for r in range(BLOCK)]
        self.k_rows, self.c0_rows, self.c1_rows = (
            [self.splat(self.at(vector, place)) for place in places] for vector in (self.k, self.c0, self.c1)
        )

    def at(self, pointer: Any, index: Any) -> Any:
        return self.b.gep(pointer, [index])

    def load(self, pointer: Any, index: Any) -> Any:
        return self.b.load(self.b.bitcast(self.at(pointer, index), _VECTOR.as_pointer()), align=8)

    def store(self, value: Any, pointer: Any, index: Any) -> None:
        self.b.store(value, self.b.bitcast(self.at(pointer, index), _VECTOR.as_pointer()), align=8)

    def splat(self, pointer: Any) -> Any:
        lane = self.b.insert_element(_UNDEFINED, self.b.load(pointer), ir.Constant(ir.IntType(32), 0))
        return self.b.shuffle_vector(lane, _UNDEFINED, ir.Constant(_EIGHT, [0] * BLOCK))

    def multiply_add(self, x: Any, y: Any, z: Any) -> Any:
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        return self.b.call(cgutils.get_or_insert_function(self.b.module, kind, "llvm.fma.v8f64"), [x, y, z])

    def tile(self, sums: list[Any], j: Any, mirrored: bool) -> list[Any]:
        """Eight columns of the eight rows; `mirrored`: they stand for their transposes as well."""
        k, place = self.load(self.k, j), self.b.mul(j, _int(BLOCK))
        w0, w1 = (self.load(self.w0, j), self.load(self.w1, j)) if self.update else (None, None)
        below = [self.load(self.out, j), ir.Constant(_VECTOR, [0.0] * BLOCK)] if mirrored else []
        result = []
        for r in range(BLOCK):
            element = self.load(self.rows[r], place)
            if self.update:
                element = self.multiply_add(self.c0_rows[r], w0, element)
                element = self.multiply_add(self.c1_rows[r], w1, element)
                self.store(element, self.rows[r], place)
            result.append(self.multiply_add(element, k, sums[r]))
            if mirrored:
                below[r % 2] = self.multiply_add(element, self.k_rows[r], below[r % 2])
        if mirrored:  # two chains of sums: one would wait for itself
            self.store(self.b.fadd(*below), self.out, j)
        return result

    def loop(self) -> None:
        """All tiles left of the diagonal's, then that one, then the rows' sums."""
        b, entry, end = self.b, self.b.block, self.first
        head, body, done = (b.append_basic_block(name) for name in ("panel.head", "panel.body", "panel.done"))
        b.branch(head)
        b.position_at_end(head)
        j, sums = b.phi(_INT), [b.phi(_VECTOR) for _ in range(BLOCK)]
        b.cbranch(b.icmp_signed("<", j, end), body, done)
        b.position_at_end(body)
        after = self.tile(sums, j, mirrored=True)
        j.add_incoming(_int(0), entry)
        j.add_incoming(b.add(j, _int(BLOCK)), body)
        for total, value in zip(sums, after, strict=True):
            total.add_incoming(ir.Constant(_VECTOR, [0.0] * BLOCK), entry)
            total.add_incoming(value, body)
        b.branch(head)
        b.position_at_end(done)
        total = self.totals(self.tile(sums, end, mirrored=False))
        self.store(b.fadd(self.load(self.out, self.first), total), self.out, self.first)

    def totals(self, vectors: list[Any]) -> Any:
        """One vector with the sum of the lanes of each of eight: neighbours are added, three times over."""
        while len(vectors) > 1:
            pairs = [(vectors[i], vectors[i + 1]) for i in range(0, len(vectors), 2)]
            vectors = [self.b.fadd(self.lanes(*pair, first=0), self.lanes(*pair, first=1)) for pair in pairs]
        return vectors[0]

    def lanes(self, left: Any, right: Any, first: int) -> Any:
        """Every second lane of two vectors."""
        places = ir.Constant(_EIGHT, list(range(first, 2 * BLOCK, 2)))
        return self.b.shuffle_vector(left, right, places)


def _int(value: int) -> Any:
    return ir.Constant(_INT, value)


def _panel(update: bool) -> Callable[..., None]:
    """The panel as something compiled code can call: (matrix, first row, rank2, its row length, k, out)."""

    @intrinsic  # type: ignore[untyped-decorator]
    def panel(typing: Any, matrix: Any, first: Any, rank2: Any, stride: Any, k: Any, out: Any) -> Any:
        def write(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            pairs = zip(signature.args, values, strict=True)
            pointers = [
                context.make_array(kind)(context, builder, value).data if isinstance(kind, types.Array) else value
                for kind, value in pairs
            ]
            _Emit(builder, pointers, update).loop()
            return context.get_dummy_value()

        return types.void(matrix, first, rank2, stride, k, out), write

    made: Callable[..., None] = panel
    return made


_update_panel, _product_panel = _panel(update=True), _panel(update=False)
