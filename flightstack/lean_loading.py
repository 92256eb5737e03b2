"""Compiled code is loaded without what only compiling needs.

Before numba loads a function that was compiled before, it imports all that it implements of Python and NumPy and
compiles its own counting of references: 0.25 s at each start.  What is loaded holds all of that already; of numba it
calls functions in C by their addresses only.  Whoever compiles has numba prepare the rest, then as ever.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache, wraps
from typing import Any

from llvmlite import binding  # type: ignore[import-untyped]
from numba.core import environment
from numba.core.runtime import _nrt_python


def load_leanly(kept: Any) -> Callable[..., Any]:
    """What loads from this cache of a function's: numba's `load_overload` without its preparations."""

    def load_overload(signature: Any, target: Any) -> Any:
        _prepare()
        with kept._guard_against_spurious_io_errors():
            return kept._load_overload(signature, target)

    return load_overload


@cache
def _prepare() -> None:
    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)
    environment._rebuild_env = _without_import(environment._rebuild_env)


def _without_import(rebuild: Callable[..., Any]) -> Callable[..., Any]:
    """What a function needs of Python's, of numba's own functions without their modules: only object mode has globals.

    It goes by the old one's name, for the pickles that hold it.
    """

    @wraps(rebuild)
    def rebuilt(module: str, constants: list[Any], name: str) -> Any:
        if environment.lookup_environment(name) or module in sys.modules or not module.startswith("numba."):
            return rebuild(module, constants, name)
        made = environment.Environment({"__name__": module})
        made.consts[:] = constants
        made.env_name = name
        environment.Environment._memo[name] = made
        return made

    return rebuilt
