"""OSQP workspace through the compiled extension, without the Python wrapper around it.

The public wrapper adds 16 to 35 us to a solve: it copies every field of the statistics into a new object, and clips and
stores its arguments. The extension under it is not a public interface. So only this file calls it, tests it once in
each process against the wrapper, and falls back to the wrapper if the two differ.

The extension takes any array: from a strided one, a shorter one or one of another type it reads wrong numbers without
an error. Every argument is therefore converted to contiguous float64, and its length is checked.
"""

from __future__ import annotations

import functools
import signal
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
import osqp
from scipy.sparse import csc_array, csc_matrix, triu

from ltv_mpc.messages import Array, SolveStatus

Settings = Mapping[str, float | int | bool]

STATUS = {
    int(osqp.SolverStatus.OSQP_SOLVED): SolveStatus.SOLVED,
    int(osqp.SolverStatus.OSQP_SOLVED_INACCURATE): SolveStatus.ITERATION_LIMIT,
    int(osqp.SolverStatus.OSQP_MAX_ITER_REACHED): SolveStatus.ITERATION_LIMIT,
    int(osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE): SolveStatus.INFEASIBLE,
    int(osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE): SolveStatus.INFEASIBLE,
    int(osqp.SolverStatus.OSQP_DUAL_INFEASIBLE): SolveStatus.INFEASIBLE,
    int(osqp.SolverStatus.OSQP_DUAL_INFEASIBLE_INACCURATE): SolveStatus.INFEASIBLE,
}
"""Status by OSQP's own; one that is missing here is ``FAILED``."""

INTERRUPTED = int(osqp.SolverStatus.OSQP_SIGINT)

BASE_SETTINGS: Settings = {
    "verbose": False,
    "scaling": 0,
    "rho": 1.0,
    # A state without a cost has only sigma on its diagonal. With OSQP's default of 1e-6, rows scaled by 300 leave
    # 300^2 / 1e-6 in the factor. Its solution then has an error beyond the tolerance where duals are large, for example
    # 10 m off a line.
    "sigma": 1e-4,
    "adaptive_rho": 0,
    "rho_is_vec": 0,
    "eps_rel": 0.0,
    "eps_prim_inf": 1e-12,  # box and slew always have a common point, so a certificate of infeasibility is of no use
    "eps_dual_inf": 1e-12,
    "check_dualgap": 0,
    "polishing": 0,
    "time_limit": 1e10,
}
"""Plain ADMM on rows that the caller has scaled: step size 1, absolute residuals, limited by iterations and never by
time.
"""


class SolveStatistics(NamedTuple):
    """Statistics of OSQP's last solve."""

    iterations: int
    primal_residual: float  # of the problem as given, infinity norm
    dual_residual: float


class Workspace(Protocol):
    """OSQP workspace for problems of one pattern: minimise 1/2 x' P x + q' x subject to l <= A x <= u."""

    def update_vectors(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Replace the vectors.

        Parameters
        ----------
        q : (n,) linear cost.
        l, u : (m,) finite bounds.
        """
        ...

    def update_matrix(self, A: Array) -> None:
        """Replace all stored entries of A (nnz,), by column, and factorise; P never changes."""
        ...

    def set_limits(self, iterations: int, tolerance: float) -> None:
        """Set the limits of the next solves.

        Parameters
        ----------
        iterations : largest number of iterations.
        tolerance : absolute residuals at which a solve ends.
        """
        ...

    def warm_start(self, x: Array, y: Array) -> None:
        """Set the point at which the next solve starts; without it a solve starts where the last one ended.

        Parameters
        ----------
        x : (n,) primal point.
        y : (m,) dual.
        """
        ...

    def solve(self) -> SolveStatus:
        """Solve. OSQP catches Ctrl-C during a solve; the signal is raised again afterwards."""
        ...

    def solution(self) -> tuple[Array, Array]:
        """Return x (n,) and y (m,) of the last solve; the arrays belong to the caller."""
        ...

    def statistics(self) -> SolveStatistics:
        """Return the statistics of the last solve."""
        ...


def make_workspace(P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> Workspace:  # noqa: E741
    """Set up OSQP for a problem, through the extension if it works.

    Parameters
    ----------
    P : (n, n) with both triangles; it never changes.
    q : (n,) linear cost.
    A : (m, n); stored zeros are entries of the pattern.
    l, u : (m,) bounds.
    settings : settings of OSQP.

    Returns
    -------
    The workspace.
    """
    return (ExtensionWorkspace if extension_works() else PublicWorkspace)(P, q, A, l, u, settings)


class ExtensionWorkspace(Workspace):
    """Workspace of the compiled extension. An array that is passed again, cycle after cycle, is checked once."""

    def __init__(self, P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> None:  # noqa: E741
        """Set up OSQP. Raises any exception if the extension has another interface: see ``extension_works``."""
        from osqp import ext_builtin

        upper, rows = _upper(P), _copy(A)
        self._sizes = rows.shape[1], rows.shape[0], rows.nnz
        self._settings: Any = ext_builtin.OSQPSettings()
        ext_builtin.osqp_set_default_settings(self._settings)
        for name, value in settings.items():
            setattr(self._settings, name, value)
        self._limits = (self._settings.max_iter, self._settings.eps_abs)
        self._info: Any = None
        self._q, self._l, self._u, self._x, self._y, self._A = [np.empty(0)] * 6
        n, m, _ = self._sizes
        q, l, u = _contiguous(q, n), _contiguous(l, m), _contiguous(u, m)  # noqa: E741
        self._solver: Any = ext_builtin.OSQPSolver(
            ext_builtin.CSC(upper), q, ext_builtin.CSC(rows), l, u, m, n, self._settings
        )

    def update_vectors(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Replace the vectors."""
        if not (q is self._q and l is self._l and u is self._u):
            n, m, _ = self._sizes
            self._q, self._l, self._u = q, l, u = _contiguous(q, n), _contiguous(l, m), _contiguous(u, m)  # noqa: E741
        _check(self._solver.update_data_vec(q, l, u))

    def update_matrix(self, A: Array) -> None:
        """Replace the stored entries of A."""
        if A is not self._A:
            _, _, entries = self._sizes
            self._A = A = _contiguous(A, entries)
        _check(self._solver.update_data_mat(None, None, A, None))

    def set_limits(self, iterations: int, tolerance: float) -> None:
        """Set the limits of the next solves."""
        if (iterations, tolerance) != self._limits:
            self._settings.max_iter, self._settings.eps_abs = iterations, tolerance
            _check(self._solver.update_settings(self._settings))
            self._limits = (iterations, tolerance)

    def warm_start(self, x: Array, y: Array) -> None:
        """Set the point at which the next solve starts."""
        if not (x is self._x and y is self._y):
            n, m, _ = self._sizes
            self._x, self._y = x, y = _contiguous(x, n), _contiguous(y, m)
        _check(self._solver.warm_start(x, y))

    def solve(self) -> SolveStatus:
        """Solve the problem."""
        self._solver.solve()
        self._info = self._solver.info
        return _status(self._info.status_val)

    def solution(self) -> tuple[Array, Array]:
        """Return x and y of the last solve."""
        solution = self._solver.solution
        return solution.x, solution.y

    def statistics(self) -> SolveStatistics:
        """Return the statistics of the last solve."""
        info = self._info
        return SolveStatistics(info.iter, info.prim_res, info.dual_res)


class PublicWorkspace(Workspace):
    """Workspace of OSQP's public wrapper: the same numbers, more slowly."""

    def __init__(self, P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> None:  # noqa: E741
        """Set up OSQP; arguments as in ``make_workspace``."""
        upper, rows = _upper(P), _copy(A)
        self._sizes = rows.shape[1], rows.shape[0], rows.nnz
        self._solver = osqp.OSQP(algebra="builtin")
        self._solver.setup(upper, q.copy(), rows, l.copy(), u.copy(), **dict(settings))
        self._limits = (self._solver.settings.max_iter, self._solver.settings.eps_abs)
        self._result: Any = None

    def update_vectors(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Replace the vectors."""
        n, m, _ = self._sizes
        q, l, u = _contiguous(q, n), _contiguous(l, m), _contiguous(u, m)  # noqa: E741
        _check(int((l > u).any()))  # the wrapper would continue with the old bounds
        self._solver.update(q=q, l=l, u=u)

    def update_matrix(self, A: Array) -> None:
        """Replace the stored entries of A."""
        _, _, entries = self._sizes
        self._solver.update(Ax=_contiguous(A, entries).copy())  # the wrapper keeps the array itself

    def set_limits(self, iterations: int, tolerance: float) -> None:
        """Set the limits of the next solves."""
        if (iterations, tolerance) != self._limits:
            self._solver.update_settings(max_iter=iterations, eps_abs=tolerance)
            self._limits = (iterations, tolerance)

    def warm_start(self, x: Array, y: Array) -> None:
        """Set the point at which the next solve starts."""
        n, m, _ = self._sizes
        self._solver.warm_start(x=_contiguous(x, n), y=_contiguous(y, m))

    def solve(self) -> SolveStatus:
        """Solve the problem."""
        self._result = self._solver.solve(raise_error=False)
        return _status(int(self._result.info.status_val))

    def solution(self) -> tuple[Array, Array]:
        """Return x and y of the last solve."""
        return np.array(self._result.x), np.array(self._result.y)

    def statistics(self) -> SolveStatistics:
        """Return the statistics of the last solve."""
        info = self._result.info
        return SolveStatistics(int(info.iter), float(info.prim_res), float(info.dual_res))


@functools.cache
def extension_works() -> bool:
    """Return True if the extension has this interface and the wrapper's results: tested once, on a small QP."""
    try:
        raw, public = _exercise(ExtensionWorkspace), _exercise(PublicWorkspace)
        return all(np.array_equal(a, b) for a, b in zip(raw, public, strict=True))
    except Exception:  # another interface can fail in any way, and the wrapper replaces it
        return False


def _exercise(kind: type[ExtensionWorkspace] | type[PublicWorkspace]) -> list[Array]:
    """Make every call once, and return the results."""
    P, A = csc_array(np.array([[2.0, 0.5], [0.5, 1.0]])), csc_array(np.array([[1.0, 1.0], [1.0, -1.0]]))
    bound = np.array([1.0, 0.3])
    tried = kind(P, np.array([1.0, -2.0]), A, -bound, bound, {**BASE_SETTINGS, "check_termination": 1, "eps_abs": 1e-6})
    tried.solve()
    seen = [*tried.solution()]
    tried.set_limits(200, 1e-9)
    tried.update_vectors(np.array([-3.0, 0.7]), -2.0 * bound, 0.5 * bound)
    tried.update_matrix(np.array([1.0, 1.1, 0.9, -1.2]))
    tried.warm_start(np.array([0.2, 0.1]), np.array([0.0, 0.4]))
    status = tried.solve()
    account = tried.statistics()
    return [
        *seen,
        *tried.solution(),
        np.array([account.iterations, account.primal_residual, status is SolveStatus.SOLVED]),
    ]


def _upper(P: csc_array) -> csc_matrix:
    """Return P's upper triangle; ``triu`` keeps stored zeros."""
    return _copy(triu(P, format="csc"))


def _copy(matrix: csc_array) -> csc_matrix:
    """Return a copy in OSQP's types: OSQP keeps the arrays that it is set up with."""
    parts = matrix.data.astype(np.float64), matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    return csc_matrix(parts, shape=matrix.shape)


def _contiguous(values: Array, length: int) -> Array:
    """Return the values as contiguous float64. Raises ``ValueError`` for a wrong length, which OSQP does not check."""
    exact = np.ascontiguousarray(values, dtype=np.float64)
    if exact.shape != (length,):
        raise ValueError(f"expected {length} numbers, got an array of shape {exact.shape}")
    return exact


def _check(error: int) -> None:
    """Raise ``ValueError`` if OSQP returned an error."""
    if error:
        raise ValueError(f"OSQP rejected the data (error {error})")


def _status(value: int) -> SolveStatus:
    """Return the status; raise the signal again if Ctrl-C ended the solve."""
    if value == INTERRUPTED:
        signal.raise_signal(signal.SIGINT)
    return STATUS.get(value, SolveStatus.FAILED)
