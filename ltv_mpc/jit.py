"""The one place that imports numba: a typed decorator, and a cache that is never stale.

numba's own cache notices an edit of a function's file, not of another file that the function calls into. So the
cache lives in a folder whose name is a hash of every source file with compiled functions, of the compiler's version
and of the processor: an edit anywhere starts a new folder. Where no folder can be written, a temporary one serves;
child processes inherit it through the environment.
"""

from __future__ import annotations

import hashlib
import os
import platform
import tempfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

import numpy as np
import numpy.typing as npt

P = ParamSpec("P")
R = TypeVar("R")

MARK = b"@jit"


def _sources() -> list[Path]:
    here = Path(__file__).resolve().parent
    roots = [here, here.parent / "sim"]
    return sorted(p for root in roots if root.is_dir() for p in root.rglob("*.py") if MARK in p.read_bytes())


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({x for x in lines if x.startswith(("model name", "flags"))}))


def fingerprint() -> str:
    """A hash of all compiled sources, the compiler and the processor: 16 hexadecimal digits."""
    digest = hashlib.sha256()
    for path in _sources():
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    for package in ("numba", "llvmlite", "numpy"):
        digest.update(f"{package} {metadata.version(package)}\n".encode())
    digest.update(_processor().encode())
    digest.update(platform.python_version().encode())
    return digest.hexdigest()[:16]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def cache_folder() -> tuple[Path, bool]:
    """Where compiled code is kept, and whether it will be there next time."""
    name = fingerprint()
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given and Path(given).name == name:  # a parent process chose it
        return Path(given), True
    base = given or os.environ.get("XDG_CACHE_HOME")
    try:
        root = Path(base) if base else Path.home() / ".cache"
    except RuntimeError:  # no HOME
        root = Path("/nonexistent")
    folder = root / "ltv-mpc" / name
    if _writable(folder):
        return folder, True
    return Path(tempfile.mkdtemp(prefix="ltv-mpc-")) / name, False


CACHE, CACHE_IS_PERSISTENT = cache_folder()
os.environ["NUMBA_CACHE_DIR"] = str(CACHE)

import numba  # noqa: E402  (the variable above must be set first)

JIT_FUNCTIONS: list[str] = []
"""Names of the functions that this process may come to compile, as far as they are imported."""


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile at the first call; floating-point operations keep their order (no fast-math), so that runs repeat.

    What it calls becomes a part of it. Between functions numba counts, with a locked instruction each, who holds every
    array that is handed on, and looks at every return for an error: a third of what a cycle's kernels took.
    """
    JIT_FUNCTIONS.append(f"{function.__module__}.{function.__qualname__}")
    compiled = numba.njit(cache=True, fastmath=False, error_model="numpy", forceinline=True)
    return cast("Callable[P, R]", compiled(function))


@jit
def copy_to(to: npt.NDArray[np.float64], of: npt.NDArray[np.float64]) -> None:
    """``to[:] = of`` for arrays of one shape, (n,) or (n, m).

    numba looks whether shapes agree, and for the words that it would say then it compiles strings, lists of strings and
    their joining: seconds in each process that fills the cache.
    """
    for i in range(to.size):
        to.flat[i] = of.flat[i]
