"""Compiled hot loops: numba with a cache that can't go stale.

Numba keys its on-disk cache by the decorated function's own file only, so editing a *called* function in another
file would leave the caller's old machine code in use.  Here the cache folder's name carries a hash over every
source file that uses this module: any edit starts a fresh folder.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import config as _numba_config

F = TypeVar("F", bound=Callable[..., Any])

_ROOT = Path(__file__).resolve().parent.parent
_KEEP_FOLDERS = 8
_KEEP_S = 86_400.0


def _source_hash() -> str:
    """Hash of all compiled sources of the project, in a stable order."""
    digest = hashlib.sha256(numba.__version__.encode())
    for package in ("flightstack", "sim", "gap", "benchmarks"):
        for path in sorted((_ROOT / package).rglob("*.py")):
            text = path.read_bytes()
            if b"flightstack.jit" in text:
                digest.update(path.relative_to(_ROOT).as_posix().encode())
                digest.update(text)
    return digest.hexdigest()[:16]


def _make_cache_folder() -> Path:
    """The folder for this state of the sources, made if need be; old ones are dropped."""
    name = f"numba-{_source_hash()}"
    for base in (Path.home() / ".cache" / "flightstack", Path(tempfile.gettempdir()) / "flightstack-cache"):
        folder = base / name
        try:
            fresh = not folder.is_dir()
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError:
            continue
        if fresh:
            _drop_old_folders(base)
        return folder
    return Path(tempfile.mkdtemp(prefix="flightstack-numba-"))


def _drop_old_folders(base: Path) -> None:
    try:
        folders = sorted(base.glob("numba-*"), key=lambda path: path.stat().st_mtime, reverse=True)
        for old in folders[_KEEP_FOLDERS:]:
            if time.time() - old.stat().st_mtime > _KEEP_S:
                shutil.rmtree(old, ignore_errors=True)
    except OSError:  # another process tidies at the same time: its business
        return


if not _numba_config.CACHE_DIR:  # a user's own NUMBA_CACHE_DIR wins
    _numba_config.CACHE_DIR = str(_make_cache_folder())


def cache_folder() -> Path:
    """Where compiled functions of this state of the sources are kept."""
    return Path(_numba_config.CACHE_DIR)


def njit(function: F) -> F:
    """Compile `function` in nopython mode, IEEE arithmetic (no fastmath: same seed, same bytes), cached on disk."""
    return _compiled(function, inline=True, relaxed=False)


def njit_called(function: F) -> F:
    """`njit` that callers call instead of copying it into themselves: for long functions with several callers."""
    return _compiled(function, inline=False, relaxed=False)


def njit_vector(function: F) -> F:
    """`njit` for loops over many points: sums may be taken in another order and products fused into them.

    That is what fills the machine's vector registers.  NaN and infinity keep their meaning.  The last bits may depend
    on the kind of processor (not on the run: same machine and seed, same bytes).
    """
    return _compiled(function, inline=True, relaxed=True)


def _compiled(function: F, inline: bool, relaxed: bool) -> F:
    # Said outright: a function that leaves fastmath open takes it over from whichever caller compiles it first.
    fastmath = {"reassoc", "contract", "nsz"} if relaxed else False
    compiled: F = numba.njit(cache=True, error_model="numpy", forceinline=inline, fastmath=fastmath)(function)
    return compiled
