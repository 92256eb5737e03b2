"""One scalar function, many vehicles at once: compiled again so that it fills the processor's vector registers.

The physics is written once, for one vehicle's row.  Here it is compiled a second time over a block of LANES vehicles
laid out by field (field j of lane i at j * LANES + i): `lane` is one vehicle's row in such a block, `across_lanes` the
function and all that it calls with arithmetic that a vectoriser may reorder.  A loop over the lanes round such a
function becomes straight vector code, its branches selections.  The numbers differ from the scalar ones in their last
bits, and between kinds of processors; not between runs, threads or places in a batch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import CellType, FunctionType, ModuleType
from typing import Any

import numba
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

LANES = 16
"""Vehicles of a block: two of the widest registers, so that one computes while the other waits."""
_OPTIONS: Mapping[str, Any] = {
    "error_model": "numpy", "forceinline": True, "fastmath": {"reassoc", "contract", "arcp", "nsz"},
}  # fmt: skip
_VIEW = types.Array(types.float64, 1, "A")
_FIELDS = 1 << 20
"""A view's length as the compiler sees it: a constant, above every index."""


def _lane_code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    block = context.make_array(signature.args[0])(context, builder, arguments[0])
    view = context.make_array(_VIEW)(context, builder)
    length, step, size = (ir.Constant(ir.IntType(64), value) for value in (_FIELDS, 8 * LANES, 8))
    populate_array(
        view,
        data=builder.gep(block.data, [arguments[1]], inbounds=True),
        shape=cgutils.pack_array(builder, [length]),
        strides=cgutils.pack_array(builder, [step]),
        itemsize=size,
        meminfo=None,
    )
    return view._getvalue()


@intrinsic  # type: ignore[untyped-decorator]
def lane(typing: Any, block: Any, place: Any) -> Any:
    """The row of one vehicle in a block: every LANES-th number from `place` on; valid while the block is."""
    return _VIEW(block, types.intp), _lane_code


def _call_code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    address, *values = arguments
    words = [
        context.make_array(kind)(context, builder, value).data if isinstance(kind, types.Array) else value
        for kind, value in zip(signature.args[1:], values, strict=True)
    ]
    function = ir.FunctionType(ir.VoidType(), [word.type for word in words])
    builder.call(builder.inttoptr(address, function.as_pointer()), words)
    return context.get_dummy_value()


@intrinsic  # type: ignore[untyped-decorator]
def call(typing: Any, address: Any, first: Any, second: Any, third: Any) -> Any:
    """Call the function at `address`, an array as the pointer to its numbers and a whole number as it is.

    What `compiled_at` has compiled, which is then compiled once and not once more for each caller, or a library's own.
    """
    kinds = [kind if isinstance(kind, types.Array) else types.intp for kind in (first, second, third)]
    return types.void(types.intp, *kinds), _call_code


def compiled_at(function: Callable[..., None]) -> int:
    """The address of a function of two pointers to float64 and a whole number, compiled and cached on disk."""
    pointer = types.CPointer(types.float64)  # type: ignore[attr-defined]
    signature = types.void(pointer, pointer, types.intp)
    return int(numba.cfunc(signature, cache=True, error_model="numpy")(function).address)


def vectorised(function: Callable[..., Any]) -> Any:
    """Compile one function as `across_lanes` compiles all that it reaches."""
    return numba.njit(**_OPTIONS)(function)


@vectorised
def _expm1(x: float) -> float:
    """exp(x) - 1 for x <= 0, to 1e-15: Taylor's series of x / 64, doubled six times; below -40 it is -1."""
    h = max(x, -40.0) / 64.0
    tail = 1 / 24 + h * (1 / 120 + h * (1 / 720 + h * (1 / 5040 + h / 40320)))
    e = h * (1.0 + h * (1 / 2 + h * (1 / 6 + h * tail)))
    e = e * (e + 2.0)
    e = e * (e + 2.0)
    e = e * (e + 2.0)
    e = e * (e + 2.0)
    e = e * (e + 2.0)
    return float(e * (e + 2.0))


@vectorised
def _exp(x: float) -> float:
    """exp(x) for x <= 0, absolutely to 1e-15."""
    return 1.0 + float(_expm1(x))


def _vector_math() -> ModuleType:
    """`math` whose exponentials, of what decays, are arithmetic: a call would end the vectorising."""
    module = ModuleType("vector_math")
    module.__dict__.update({name: value for name, value in vars(math).items() if not name.startswith("__")})
    module.__dict__.update(exp=_exp, expm1=_expm1)
    return module


_MATH = _vector_math()


def across_lanes(function: Any, replaced: Mapping[str, Mapping[str, Any]]) -> Any:
    """`function`, compiled, and all compiled functions that it reaches, compiled to be inlined into a loop over lanes.

    `replaced`: by a module's last name, functions that stand for the module's own.
    """
    return _Copies(replaced).of(function)


class _Copies:
    def __init__(self, replaced: Mapping[str, Mapping[str, Any]]) -> None:
        self._replaced = replaced
        self._done: dict[int, Any] = {}

    def of(self, value: Any) -> Any:
        """The copy of a compiled function or of a module of such; anything else as it is."""
        if value is math:
            return _MATH
        project = isinstance(value, ModuleType) and value.__name__.startswith("flightstack")
        if not project and not isinstance(value, numba.core.dispatcher.Dispatcher):
            return value
        if id(value) not in self._done:
            self._done[id(value)] = self._module(value) if project else self._function(value)
        return self._done[id(value)]

    def _function(self, compiled: Any) -> Any:
        python = compiled.py_func
        own = self._replaced.get(python.__module__.rsplit(".", 1)[-1], {})
        if python.__name__ in own:
            return own[python.__name__]
        known = dict(python.__globals__)
        for name in python.__code__.co_names:
            if name in known:
                known[name] = self.of(known[name])
        cells = tuple(CellType(self.of(cell.cell_contents)) for cell in python.__closure__ or ())
        return vectorised(FunctionType(python.__code__, known, python.__name__, python.__defaults__, cells))

    def _module(self, module: ModuleType) -> ModuleType:
        copy = self._done[id(module)] = ModuleType(module.__name__)
        for name, value in vars(module).items():
            if not name.startswith("__"):
                setattr(copy, name, self.of(value))
        return copy
