"""What makes a process quicker that only compiles; it changes numba itself, so no other process should use it.

Each operation is typed once.  For every `a * b` of floats numba tries the templates that are known for `*` from the
first, strings' and arrays' included, words an error for each that does not fit, and forgets which one did.  The same
operation on the same types has the same signature everywhere, so here it is remembered.

A function that only compiled callers call is linked into each of them as intermediate code and optimised there.  numba
makes machine code of it all the same, which nobody ever runs: a third of the simulator's compiling.  Left out, the
caller's arithmetic is the same in IEEE order, but not where sums may be taken in another (`njit_vector`): the
intermediate code of what such a function calls would be another one.  All of those are the Gaussian process's and call
nothing of the project from elsewhere, so machine code is made of everything there and of numba's own.

Processes that compile side by side keep their code one after the other: numba reads a function's index, takes the next
free number and writes both, and of two that do so at once one may find the other's code under its own signature.
"""

from __future__ import annotations

import fcntl
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any
from weakref import WeakSet

from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import CPUCodeLibrary, JITCPUCodegen
from numba.core.environment import lookup_environment
from numba.core.typed_passes import BaseNativeLowering
from numba.core.types.functions import BaseFunction

from flightstack.jit import cache_folder

_PURE = ("_operator", "math", "builtins")
"""Modules whose functions' signatures depend on the arguments' types and nothing else."""
_COLLECTED_AFTER = (20_000, 50, 100)
_VECTORS = "flightstack.gp."
"""Where every `njit_vector` is, and what those call."""
_ENVIRONMENT = "_ZN08NumbaEnv"
"""How names of global variables begin that point to what a function needs of Python's."""


@contextmanager
def quick_compiling(strict: bool = False) -> Iterator[None]:
    """All of it, meanwhile; `strict`: nothing is compiled whose sums may be taken in another order."""
    with typed_once(), kept_in_turn(), seldom_collected(), linked_only(strict):
        yield


@contextmanager
def seldom_collected() -> Iterator[None]:
    """Python's collector runs seldom meanwhile: numba makes millions of objects, of which hardly any lie in cycles."""
    original = gc.get_threshold()
    gc.set_threshold(*_COLLECTED_AFTER)
    try:
        yield
    finally:
        gc.set_threshold(*original)


@contextmanager
def linked_only(strict: bool = True) -> Iterator[None]:
    """Of a function without a wrapper for Python no machine code is made meanwhile, and its callers optimise it.

    Unless `strict` of the project's only, but for what may take sums in another order and what that calls.
    """
    linked = WeakSet[Any]()
    lower, optimise = BaseNativeLowering.run_pass, CPUCodeLibrary._optimize_final_module
    finish, set_env = CPUCodeLibrary._finalize_final_module, JITCPUCodegen.set_env

    def run_pass(self: Any, state: Any) -> Any:
        name = state.func_id.modname or ""
        ordered = strict or not name.startswith(("numba.", _VECTORS))
        if state.library is None and _is_linked_only(state.flags) and ordered:
            state.library = state.targetctx.codegen().create_library(state.func_id.func_qualname)
            linked.add(state.library)
        return lower(self, state)

    def _optimize_final_module(self: Any) -> None:
        if self not in linked:
            optimise(self)

    def _finalize_final_module(self: Any) -> None:
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

    set_env_of_code.__name__ = "set_env"
    with _replaced(
        (BaseNativeLowering, run_pass),
        (CPUCodeLibrary, _optimize_final_module),
        (CPUCodeLibrary, _finalize_final_module),
        (JITCPUCodegen, set_env_of_code),
    ):
        yield


def _is_linked_only(flags: Any) -> bool:
    """Whether only compiled callers call what is compiled so, C's among those that need its address."""
    return flags.no_cpython_wrapper and flags.no_cfunc_wrapper and not flags.fastmath.flags


@contextmanager
def typed_once() -> Iterator[None]:
    """Operators' and scalar functions' signatures are remembered meanwhile."""
    original = BaseFunction.get_call_type
    known: dict[Any, tuple[Any, Any]] = {}

    def get_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws or getattr(self.typing_key, "__module__", None) not in _PURE:
            return original(self, context, args, kws)
        key = (self.typing_key, self.templates, context, args)
        if key not in known:
            signature = original(self, context, args, kws)
            known[key] = signature, self.get_impl_key(signature)
        signature, self._impl_keys[known[key][0].args] = known[key]
        return signature

    with _replaced((BaseFunction, get_call_type)):
        yield


@contextmanager
def locked(name: str) -> Iterator[None]:
    """Nobody else does meanwhile what goes by this name; where there are no locks, all do."""
    try:
        file = (cache_folder() / f"{name}.lock").open("w")
    except OSError:
        yield
        return
    with file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def kept_in_turn() -> Iterator[None]:
    """One process at a time adds to the cache."""
    keep = IndexDataCacheFile.save

    def save(self: Any, key: Any, data: Any) -> None:
        with locked("keeping"):
            keep(self, key, data)

    with _replaced((IndexDataCacheFile, save)):
        yield


@contextmanager
def _replaced(*methods: tuple[type, Any]) -> Iterator[None]:
    """Methods of classes, by others of the same names."""
    originals = [(owner, new.__name__, getattr(owner, new.__name__)) for owner, new in methods]
    for owner, new in methods:
        setattr(owner, new.__name__, new)
    try:
        yield
    finally:
        for owner, name, original in originals:
            setattr(owner, name, original)
