"""Just-in-time compilation: a typed decorator, and a cache that is never stale. Only this file imports numba.

numba's own cache notices an edit of a function's file, but not of another file that the function calls into. So the
machine code of each function is stored under a hash of all that it depends on (``kernel_hash.py``), in a folder whose
name is a hash of the compiler's version and of the processor. If the folder cannot be written, a temporary one is used.
Child processes inherit it through the environment.
"""

from __future__ import annotations

import hashlib
import os
import platform
import tempfile
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from types import FunctionType
from typing import Any, ClassVar, ParamSpec, TypeVar, cast

import numpy as np
import numpy.typing as npt

from ltv_mpc.kernel_hash import kernel_hash

P = ParamSpec("P")
R = TypeVar("R")


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({x for x in lines if x.startswith(("model name", "flags"))}))


def fingerprint() -> str:
    """Return a hash of compiler and processor: 16 hexadecimal digits."""
    versions = [f"{package} {metadata.version(package)}" for package in ("numba", "llvmlite", "numpy")]
    return hashlib.sha256("\n".join([*versions, _processor(), platform.python_version()]).encode()).hexdigest()[:16]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def cache_folder() -> tuple[Path, bool]:
    """Return the folder for compiled code, and True if it persists for the next process."""
    name = fingerprint()
    inherited = os.environ.get("NUMBA_CACHE_DIR")
    if inherited and Path(inherited).name == name:  # a parent process chose it
        return Path(inherited), True
    base = inherited or os.environ.get("XDG_CACHE_HOME")
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
from numba.core import caching, dispatcher  # noqa: E402


class _Locator(caching._CacheLocator):
    """Place of a function's machine code: a file that is named after the function and its hash."""

    def __init__(self, function: FunctionType, file: str) -> None:
        """Compute the hash."""
        self._py_file, self._function = file, function
        self._hash = kernel_hash(function, OPTIONS[function])

    def get_cache_path(self) -> str:
        """Return the folder of its module."""
        return str(CACHE / self._function.__module__)

    def get_source_stamp(self) -> str:
        """Return nothing: the file's name has the hash."""
        return ""

    def get_disambiguator(self) -> str:
        """Return the hash, which is a part of the file's name."""
        return self._hash

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> _Locator:
        """Return the place of a function.

        Parameters
        ----------
        py_func : plain Python function.
        py_file : its file.
        """
        return cls(py_func, py_file)


class _CacheImpl(caching.CompileResultCacheImpl):
    """Storage of a compiled function in the place of ``_Locator``, as numba does it."""

    _locator_classes: ClassVar = [_Locator]  # type: ignore[misc]


class _Cache(caching.FunctionCache):
    """Cache of one function; its place is found at the first call, when all that the function names exists."""

    _impl_class = _CacheImpl

    def __init__(self, function: FunctionType) -> None:
        """Store the function."""
        self._function = function

    def __getattr__(self, name: str) -> Any:
        """Find the place as numba does it, when the first attribute is needed that numba sets there."""
        if "_impl" in vars(self):  # numba has set all there is
            raise AttributeError(name)
        super().__init__(self._function)  # type: ignore[no-untyped-call]
        return getattr(self, name)


OPTIONS: dict[Any, dict[str, Any]] = {}
"""Options with which each function is compiled."""


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function at its first call.

    Floating-point operations keep their order (no fast-math), so that runs repeat. Calls between compiled functions are
    inlined: otherwise numba counts the references to every array argument, with a locked instruction each, and checks
    every return for an error. That took a third of the time of a cycle's kernels.
    """
    return _compiled(function, forceinline=True)


def jit_outlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function as ``jit`` does, but leave it to the compiler whether to inline it.

    It is for a long function that compiled functions call at several places: every copy is optimised again, which takes
    seconds, and a call is short against what the function does.
    """
    return _compiled(function, forceinline=False)


def _compiled(function: Callable[P, R], *, forceinline: bool) -> Callable[P, R]:
    # Without the wrapper for callers in C: it would be a further copy of the function, optimised again.
    options: dict[str, Any] = {
        "fastmath": False,
        "error_model": "numpy",
        "forceinline": forceinline,
        "no_cfunc_wrapper": True,
    }
    OPTIONS[function] = options
    compiled = numba.njit(**options)(function)
    compiled._cache = _Cache(cast("FunctionType", function))
    return cast("Callable[P, R]", compiled)


def share_compilation() -> None:
    """Divide the work with the other processes that fill this cache: each function is compiled by one of them.

    A process that needs a function which another one compiles waits, and then loads it. Calls between functions have
    no cycle, so neither have the waits. A process keeps its lock until it ends or the function is stored, so do this
    only in processes that end by themselves or with their parent.
    """
    import fcntl

    unlocked = dispatcher.Dispatcher.compile
    locks = CACHE / "locks"
    locks.mkdir(parents=True, exist_ok=True)

    def _locked(of: Any, signature: Any) -> Any:
        function = of.py_func
        if not isinstance(of._cache, caching.FunctionCache):  # numba's own functions are compiled by each process
            return unlocked(of, signature)
        with (locks / f"{function.__module__}.{function.__qualname__}").open("wb") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return unlocked(of, signature)

    dispatcher.Dispatcher.compile = _locked  # type: ignore[method-assign, assignment]


@jit
def copy_to(to: npt.NDArray[np.float64], source: npt.NDArray[np.float64]) -> None:
    """Copy an array into another one of the same shape, like ``to[:] = source``.

    numba's own assignment checks the shapes. To compile the text of its error takes seconds in each process that fills
    the cache.

    Parameters
    ----------
    to : (n,) or (n, m), overwritten.
    source : array of the same shape.
    """
    for i in range(to.size):
        to.flat[i] = source.flat[i]


@jit
def count_up_to(values: npt.NDArray[Any], limit: float) -> int:
    """Return how many entries of an ascending array are at most ``limit``; all of them if it is NaN.

    This is ``np.searchsorted(values, limit, side="right")``, which takes ten times as long to compile.

    Parameters
    ----------
    values : (n,) ascending.
    limit : number of the same type.
    """
    low, high = 0, len(values)
    while low < high:
        middle = (low + high) // 2
        if limit < values[middle]:
            high = middle
        else:
            low = middle + 1
    return low


@jit
def linear_at(knots: npt.NDArray[Any], values: npt.NDArray[np.float64], at: float) -> float:
    """Return the value at one place: linear between the knots, constant beyond them, zero if there are none.

    Parameters
    ----------
    knots : (n,) ascending. Differences of times in nanoseconds are exact in float64.
    values : (n,) at the knots.
    at : place, of the type of the knots.
    """
    if len(knots) == 0:
        return 0.0
    k = count_up_to(knots, at)
    if k == 0 or k == len(knots):
        return float(values[max(k - 1, 0)])
    part = float(at - knots[k - 1]) / float(knots[k] - knots[k - 1])
    return float(values[k - 1] + part * (values[k] - values[k - 1]))
