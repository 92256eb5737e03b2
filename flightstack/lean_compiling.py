"""The project's functions are compiled without what nobody uses (decision 13).

A function that only compiled callers call is linked into each of them as intermediate code and optimised there.  numba
optimises it by itself first and makes machine code of it all the same, which nobody ever runs.  And to word what is
wrong where a slice gets an array of another length, numba compiles what makes text of numbers, into each function that
assigns to a slice: here such an error says no lengths.

What is optimised once instead of twice may take sums in another order where it may at all (`njit_vector`): so every
process compiles like this, the one that does nothing else and the one that flies, and the code is the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any
from weakref import WeakSet

from numba.core.codegen import CPUCodeLibrary, JITCPUCodegen
from numba.core.environment import lookup_environment
from numba.core.typed_passes import BaseNativeLowering

_ENVIRONMENT = "_ZN08NumbaEnv"
"""How names of global variables begin that point to what a function needs of Python's."""


def compile_leanly(packages: tuple[str, ...]) -> None:
    """From now on in this process, for the functions of these packages; other functions are compiled as ever.

    So with numba 0.61 and 0.68; one that lacks a method that is changed is left as it is.
    """
    with suppress(AttributeError):
        _change_numba(tuple(f"{package}." for package in packages))


def _change_numba(modules: tuple[str, ...]) -> None:
    linked = WeakSet[Any]()
    lower, optimise = BaseNativeLowering.run_pass, CPUCodeLibrary._optimize_final_module
    finish, set_env = CPUCodeLibrary._finalize_final_module, JITCPUCodegen.set_env

    def run_pass(self: Any, state: Any) -> Any:
        if not (state.func_id.modname or "").startswith(modules):
            return lower(self, state)
        if state.library is None and state.flags.no_cpython_wrapper and state.flags.no_cfunc_wrapper:
            state.library = state.targetctx.codegen().create_library(state.func_id.func_qualname)
            linked.add(state.library)
        with _plain_errors():
            return lower(self, state)

    def optimise_final_module(self: Any) -> None:
        if self not in linked:
            optimise(self)

    def finalize_final_module(self: Any) -> None:
        if self in linked:
            self._finalize_dynamic_globals()
            self._verify_declare_only_symbols()
            self._finalized = True
            return
        finish(self)
        for name in [variable.name for variable in self._final_module.global_variables]:
            environment = lookup_environment(name) if name.startswith(_ENVIRONMENT) else None
            if environment is not None:
                self._codegen.set_env(name, environment)

    def set_env_of_code(self: Any, name: str, environment: Any) -> None:
        if self._engine.get_global_value_address(name):  # what is linked only has no place yet
            set_env(self, name, environment)

    BaseNativeLowering.run_pass = run_pass
    CPUCodeLibrary._optimize_final_module = optimise_final_module
    CPUCodeLibrary._finalize_final_module = finalize_final_module
    JITCPUCodegen.set_env = set_env_of_code


@contextmanager
def _plain_errors() -> Iterator[None]:
    """What is lowered meanwhile raises an error without lengths."""
    from numba.np import arrayobj  # here: an import of 40 ms that who compiles nothing does without

    original = arrayobj.raise_with_shape_context
    arrayobj.raise_with_shape_context = _plain_error()
    try:
        yield
    finally:
        arrayobj.raise_with_shape_context = original


@cache
def _plain_error() -> Any:
    """What compiled code calls where the lengths differ."""
    from numba.extending import overload

    def lengths_differ(given: Any, wanted: Any) -> None:
        raise NotImplementedError  # only compiled code calls it

    @overload(lengths_differ)  # type: ignore[untyped-decorator]
    def compiled(given: Any, wanted: Any) -> Any:
        def raised(given: Any, wanted: Any) -> None:
            raise ValueError("cannot assign slice from input of different size")

        return raised

    return lengths_differ
