"""What makes a process quicker that only compiles; it changes numba itself, so no other process should use it.

Each operation is typed once.  For every `a * b` of floats numba tries the templates that are known for `*` from the
first, strings' and arrays' included, words an error for each that does not fit, and forgets which one did.  The same
operation on the same types has the same signature everywhere, so here it is remembered.

What only compiled callers call gets no machine code.  Numba makes it all the same, though every caller takes the
function's intermediate code into its own and makes machine code of that: nobody ever runs the function's own.

Processes that compile side by side keep their code one after the other: numba reads a function's index, takes the next
free number and writes both, and of two that do so at once one may find the other's code under its own signature.

The heap, a few hundred MB that live as long as the process does, is not walked through for garbage all the time.
"""

from __future__ import annotations

import fcntl
import gc
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any
from weakref import WeakSet

from numba.core.caching import IndexDataCacheFile
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary, JITCPUCodegen
from numba.core.types.functions import BaseFunction

from flightstack.jit import cache_folder

_PURE = ("_operator", "math", "builtins")
"""Modules whose functions' signatures depend on the arguments' types and nothing else."""
_FOR_PYTHON = "_ZN7cpython"
"""How the names of the wrappers begin that Python calls."""


@contextmanager
def quick_compiling() -> Iterator[None]:
    """All of it, meanwhile."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        with typed_once(), called_not_emitted(), kept_in_turn():
            yield
    finally:
        if collecting:
            gc.enable()


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
def called_not_emitted() -> Iterator[None]:
    """Functions without a wrapper for Python get machine code when someone asks for its address, not before."""
    emit, address = CPUCodeLibrary._finalize_final_module, JITCodeLibrary.get_pointer_to_function
    connect = JITCPUCodegen.set_env
    waiting: dict[str, Any] = {}  # environments of functions that no machine code holds yet
    held: WeakSet[Any] = WeakSet()  # libraries without machine code
    asked: WeakSet[Any] = WeakSet()  # libraries of whose functions someone wants the address

    def _finalize_final_module(self: Any) -> None:
        if self not in asked and _is_called_only(self._final_module):
            held.add(self)
            self._finalize_dynamic_globals()
            self._verify_declare_only_symbols()
            self._finalized = True
            return
        emit(self)
        for variable in self._final_module.global_variables:
            if variable.name in waiting:
                connect(self._codegen, variable.name, waiting.pop(variable.name))

    def get_pointer_to_function(self: Any, name: str) -> Any:
        self._ensure_finalized()
        if self in held and any(function.name == name for function in self.get_defined_functions()):
            held.remove(self)
            asked.add(self)
            _finalize_final_module(self)
        return address(self, name)

    def set_env(self: Any, name: str, env: Any) -> None:
        if self._engine.is_symbol_defined(name):
            connect(self, name, env)
        else:
            waiting[name] = env

    with _replaced(
        (CPUCodeLibrary, _finalize_final_module),
        (JITCodeLibrary, get_pointer_to_function),
        (JITCPUCodegen, set_env),
    ):
        yield


@contextmanager
def kept_in_turn() -> Iterator[None]:
    """One process at a time adds to the cache; where there are no locks, all do."""
    keep = IndexDataCacheFile.save

    def save(self: Any, key: Any, data: Any) -> None:
        with (cache_folder() / "keeping.lock").open("w") as file:
            with suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_EX)
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


def _is_called_only(module: Any) -> bool:
    names = [function.name for function in module.functions if not function.is_declaration]
    compiled = any(name.startswith("_ZN") for name in names)
    return compiled and not any(name.startswith(_FOR_PYTHON) for name in names)
