"""OSQP's workspace without the Python around it: the compiled extension's own calls, in one place.

The public wrapper costs 16 to 35 us a solve on top of OSQP itself: it copies every field of the account into a new
object, and clips and stores what it is given. The extension under it is no public interface, so this file alone calls
it, tries it once in each process against the wrapper, and hands out the wrapper where the two do not agree.

The extension takes any array: of a strided one, a shorter one or one of another type it reads wrong numbers without a
word. Everything that is handed on is therefore made contiguous float64, and its length is checked.
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
"""Whatever is not here is ``FAILED``."""

INTERRUPTED = int(osqp.SolverStatus.OSQP_SIGINT)

BASE_SETTINGS: Settings = {
    "verbose": False,
    "scaling": 0,
    "rho": 1.0,
    # A state without a cost has nothing but sigma on its diagonal. With OSQP's own 1e-6, rows of 300 leave 300^2 / 1e-6
    # in the factor, and in its solution an error beyond the tolerance where duals are large, as 10 m off a line.
    "sigma": 1e-4,
    "adaptive_rho": 0,
    "rho_is_vec": 0,
    "eps_rel": 0.0,
    "eps_prim_inf": 1e-12,  # box and slew always have a common point: nothing is gained by looking for a proof
    "eps_dual_inf": 1e-12,
    "check_dualgap": 0,
    "polishing": 0,
    "time_limit": 1e10,
}
"""ADMM and nothing else, on rows that the caller has scaled: one step size 1, residuals absolute, limited by
iterations and never by time."""


class SolveStatistics(NamedTuple):
    """What OSQP says of its last solve."""

    iterations: int
    primal_residual: float  # of the problem as given, infinity norm
    dual_residual: float


class Workspace(Protocol):
    """One problem of fixed pattern inside OSQP: minimise 1/2 x' P x + q' x subject to l <= A x <= u."""

    def update_vectors(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """q (n,), l and u (m,); bounds finite."""
        ...

    def update_matrix(self, A: Array) -> None:
        """Replace all stored entries of A (nnz,), by column, and factorise; P stays as it was set up."""
        ...

    def set_limits(self, iterations: int, tolerance: float) -> None:
        """Of the solves to come: most iterations, and the absolute residuals at which they end."""
        ...

    def warm_start(self, x: Array, y: Array) -> None:
        """Begin the next solve at x (n,), y (m,). Without it a solve goes on where the last one ended."""
        ...

    def solve(self) -> SolveStatus:
        """Solve. Ctrl-C, which OSQP takes for itself meanwhile, is handed on to whoever waits for it."""
        ...

    def solution(self) -> tuple[Array, Array]:
        """x (n,), y (m,) of the last solve: the caller's own."""
        ...

    def statistics(self) -> SolveStatistics:
        """The last solve's account."""
        ...


def make_workspace(P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> Workspace:  # noqa: E741
    """OSQP set up for a problem. P (n, n) with both triangles, A (m, n); entries that are stored stay stored.

    ``settings`` are OSQP's. The faster of both workspaces, where it works.
    """
    return (ExtensionWorkspace if extension_works() else PublicWorkspace)(P, q, A, l, u, settings)


class ExtensionWorkspace:
    """By the compiled extension. Arrays that come again, cycle after cycle, are looked at once."""

    def __init__(self, P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> None:  # noqa: E741
        """Raises whatever an extension of another shape raises: ``extension_works`` is asked first."""
        from osqp import ext_builtin

        upper, rows = _upper(P), _own(A)
        self._sizes = rows.shape[1], rows.shape[0], rows.nnz
        self._settings: Any = ext_builtin.OSQPSettings()
        ext_builtin.osqp_set_default_settings(self._settings)
        for name, value in settings.items():
            setattr(self._settings, name, value)
        self._limits = (self._settings.max_iter, self._settings.eps_abs)
        self._info: Any = None
        self._q, self._l, self._u, self._x, self._y, self._A = [np.empty(0)] * 6
        n, m, _ = self._sizes
        q, l, u = _exact(q, n), _exact(l, m), _exact(u, m)  # noqa: E741
        self._solver: Any = ext_builtin.OSQPSolver(
            ext_builtin.CSC(upper), q, ext_builtin.CSC(rows), l, u, m, n, self._settings
        )

    def update_vectors(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """As in ``Workspace``."""
        if not (q is self._q and l is self._l and u is self._u):
            n, m, _ = self._sizes
            self._q, self._l, self._u = q, l, u = _exact(q, n), _exact(l, m), _exact(u, m)  # noqa: E741
        _accepted(self._solver.update_data_vec(q, l, u))

    def update_matrix(self, A: Array) -> None:
        """As in ``Workspace``."""
        if A is not self._A:
            _, _, entries = self._sizes
            self._A = A = _exact(A, entries)
        _accepted(self._solver.update_data_mat(None, None, A, None))

    def set_limits(self, iterations: int, tolerance: float) -> None:
        """As in ``Workspace``."""
        if (iterations, tolerance) != self._limits:
            self._settings.max_iter, self._settings.eps_abs = iterations, tolerance
            _accepted(self._solver.update_settings(self._settings))
            self._limits = (iterations, tolerance)

    def warm_start(self, x: Array, y: Array) -> None:
        """As in ``Workspace``."""
        if not (x is self._x and y is self._y):
            n, m, _ = self._sizes
            self._x, self._y = x, y = _exact(x, n), _exact(y, m)
        _accepted(self._solver.warm_start(x, y))

    def solve(self) -> SolveStatus:
        """As in ``Workspace``."""
        self._solver.solve()
        self._info = self._solver.info
        return _status(self._info.status_val)

    def solution(self) -> tuple[Array, Array]:
        """As in ``Workspace``."""
        solution = self._solver.solution
        return solution.x, solution.y

    def statistics(self) -> SolveStatistics:
        """As in ``Workspace``."""
        info = self._info
        return SolveStatistics(info.iter, info.prim_res, info.dual_res)


class PublicWorkspace:
    """By OSQP's public wrapper: the same numbers, more slowly."""

    def __init__(self, P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> None:  # noqa: E741
        """As ``workspace`` takes them."""
        upper, rows = _upper(P), _own(A)
        self._sizes = rows.shape[1], rows.shape[0], rows.nnz
        self._solver = osqp.OSQP(algebra="builtin")
        self._solver.setup(upper, q.copy(), rows, l.copy(), u.copy(), **dict(settings))
        self._limits = (self._solver.settings.max_iter, self._solver.settings.eps_abs)
        self._result: Any = None

    def update_vectors(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """As in ``Workspace``."""
        n, m, _ = self._sizes
        q, l, u = _exact(q, n), _exact(l, m), _exact(u, m)  # noqa: E741
        _accepted(int((l > u).any()))  # the wrapper would go on with the bounds before
        self._solver.update(q=q, l=l, u=u)

    def update_matrix(self, A: Array) -> None:
        """As in ``Workspace``."""
        _, _, entries = self._sizes
        self._solver.update(Ax=_exact(A, entries).copy())  # the wrapper keeps the array that it is given

    def set_limits(self, iterations: int, tolerance: float) -> None:
        """As in ``Workspace``."""
        if (iterations, tolerance) != self._limits:
            self._solver.update_settings(max_iter=iterations, eps_abs=tolerance)
            self._limits = (iterations, tolerance)

    def warm_start(self, x: Array, y: Array) -> None:
        """As in ``Workspace``."""
        n, m, _ = self._sizes
        self._solver.warm_start(x=_exact(x, n), y=_exact(y, m))

    def solve(self) -> SolveStatus:
        """As in ``Workspace``."""
        self._result = self._solver.solve(raise_error=False)
        return _status(int(self._result.info.status_val))

    def solution(self) -> tuple[Array, Array]:
        """As in ``Workspace``."""
        return np.array(self._result.x), np.array(self._result.y)

    def statistics(self) -> SolveStatistics:
        """As in ``Workspace``."""
        info = self._result.info
        return SolveStatistics(int(info.iter), float(info.prim_res), float(info.dual_res))


@functools.cache
def extension_works() -> bool:
    """Whether the extension is there, is called as here, and does what the wrapper does: tried once, on a small QP."""
    try:
        raw, public = _try(ExtensionWorkspace), _try(PublicWorkspace)
        return all(np.array_equal(a, b) for a, b in zip(raw, public, strict=True))
    except Exception:  # an extension of another shape has its own ways to say so, and the wrapper serves
        return False


def _try(kind: type[ExtensionWorkspace] | type[PublicWorkspace]) -> list[Array]:
    """Every call once; the numbers that came of it."""
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
    """P's upper triangle; ``triu`` keeps stored zeros."""
    return _own(triu(P, format="csc"))


def _own(matrix: csc_array) -> csc_matrix:
    """A copy in the types that OSQP wants: what it is set up with belongs to it afterwards."""
    parts = matrix.data.astype(np.float64), matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    return csc_matrix(parts, shape=matrix.shape)


def _exact(values: Array, length: int) -> Array:
    """What the extension reads without a check of its own: contiguous float64 of the right length."""
    exact = np.ascontiguousarray(values, dtype=np.float64)
    if exact.shape != (length,):
        raise ValueError(f"expected {length} numbers, got an array of shape {exact.shape}")
    return exact


def _accepted(error: int) -> None:
    """OSQP's own verdict on what it was given."""
    if error:
        raise ValueError(f"OSQP rejected the data (error {error})")


def _status(value: int) -> SolveStatus:
    if value == INTERRUPTED:
        signal.raise_signal(signal.SIGINT)
    return STATUS.get(value, SolveStatus.FAILED)
