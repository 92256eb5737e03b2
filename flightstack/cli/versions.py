"""What this program is: its version and the commit that it was built of, from a checkout and from a wheel alike."""

from __future__ import annotations

import subprocess
from importlib import import_module, metadata
from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent.parent
_LIBRARIES = ("numpy", "scipy", "numba", "pymavlink", "foxglove-sdk", "osqp")


def versions() -> dict[str, str]:
    """Of the package, its libraries and the commit; what can't be found is empty."""
    return {name: version_of(name) for name in ("flightstack", *_LIBRARIES)} | {"git_commit": commit()}


def version_of(name: str) -> str:
    """Of an installed distribution; empty where it is none."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def commit() -> str:
    """As git describes the checkout, or as the build wrote it down; empty where neither is known.

    Only our own checkout is asked: an installed package may lie in a folder of somebody else's.
    """
    if (_ROOT / ".git").exists() and (_ROOT / "pyproject.toml").is_file():
        command = ["git", "-C", str(_ROOT), "describe", "--always", "--dirty", "--abbrev=12"]
        try:
            answer = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False)
        except (OSError, subprocess.SubprocessError):
            return ""
        return answer.stdout.strip() if answer.returncode == 0 else ""
    try:
        return str(import_module("flightstack._commit").COMMIT)
    except (ImportError, AttributeError):
        return ""
