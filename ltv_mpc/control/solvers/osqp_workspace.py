"""OSQP workspace through the C functions of the compiled extension, without the Python wrapper around it.

The public wrapper adds 16 to 35 us to a solve: it copies every field of the statistics into a new object, and clips and
stores its arguments. The extension exports OSQP's C interface (osqp_api_functions.h), which compiled code calls by the
addresses of its functions. So only this file knows the types of that interface, compares it once in each process with
the wrapper, and falls back to the wrapper if the two differ.

C takes any address: from a strided array, a shorter one or one of another type it would read wrong numbers without an
error. So every array is checked; an array that is passed again, cycle after cycle, is checked once.
"""

from __future__ import annotations

import ctypes
import functools
import signal
import weakref
from collections.abc import Mapping
from importlib import metadata
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import osqp
from scipy.sparse import csc_array, csc_matrix, triu

from ltv_mpc.control.qp.sparse import QpNumbers
from ltv_mpc.jit import call_c, jit
from ltv_mpc.messages import Array, SolveStatus

Settings = Mapping[str, float | int | bool]

KNOWN = "1.1."
"""Version of OSQP whose structures in memory are known."""

INT, FLOAT = ctypes.c_int32, ctypes.c_double
"""``OSQPInt`` and ``OSQPFloat``."""

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


class OsqpReport(NamedTuple):
    """Report of one solve of OSQP."""

    status: SolveStatus
    iterations: int
    primal_residual: float  # of the problem as given, infinity norm
    dual_residual: float


class Workspace(Protocol):
    """OSQP workspace for problems of one pattern: minimise 1/2 x' P x + q' x subject to l <= A x <= u."""

    x: Array
    """(n,) solution of the last solve; the next one overwrites it."""
    y: Array
    """(m,) its dual."""

    def load(self, numbers: QpNumbers, x: Array, y: Array) -> None:
        """Replace A, factorise, and replace the vectors and the point at which the next solve starts.

        Parameters
        ----------
        numbers : all stored entries of A (nnz,), by column; linear cost (n,), finite bounds (m,). P never changes.
        x : (n,) primal point.
        y : (m,) dual.

        Raises
        ------
        ValueError
            An array has another length, or a lower bound is above its upper one.
        """
        ...

    def solve(self, iterations: int, tolerance: float) -> OsqpReport:
        """Solve, from the point that was loaded or at which the last solve ended.

        OSQP catches Ctrl-C during a solve; the signal is raised again afterwards.

        Parameters
        ----------
        iterations : largest number of iterations.
        tolerance : absolute residuals at which the solve ends.
        """
        ...


def make_workspace(P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> Workspace:  # noqa: E741
    """Set up OSQP for a problem, through its C functions if they work.

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
    return (CompiledWorkspace if c_functions_work() else PublicWorkspace)(P, q, A, l, u, settings)


# --- OSQP's C interface ---


class _Settings(ctypes.Structure):
    """``OSQPSettings`` of osqp_api_types.h."""

    _fields_: ClassVar = [
        *((name, INT) for name in ("device", "linsys_solver", "allocate_solution", "verbose", "profiler_level")),
        *((name, INT) for name in ("warm_starting", "scaling", "polishing")),
        *(("rho", FLOAT), ("rho_is_vec", INT), ("sigma", FLOAT), ("alpha", FLOAT)),
        *(("cg_max_iter", INT), ("cg_tol_reduction", INT), ("cg_tol_fraction", FLOAT), ("cg_precond", INT)),
        *(("adaptive_rho", INT), ("adaptive_rho_interval", INT)),
        *(("adaptive_rho_fraction", FLOAT), ("adaptive_rho_tolerance", FLOAT), ("max_iter", INT)),
        *((name, FLOAT) for name in ("eps_abs", "eps_rel", "eps_prim_inf", "eps_dual_inf")),
        *((name, INT) for name in ("scaled_termination", "check_termination", "check_dualgap")),
        *(("time_limit", FLOAT), ("delta", FLOAT), ("polish_refine_iter", INT)),
    ]


class _Info(ctypes.Structure):
    """Beginning of ``OSQPInfo``."""

    _fields_: ClassVar = [
        *(("status", ctypes.c_char * 32), ("status_val", INT), ("status_polish", INT)),
        *((name, FLOAT) for name in ("obj_val", "dual_obj_val", "prim_res", "dual_res", "duality_gap")),
        *(("iter", INT), ("rho_updates", INT)),
    ]


class _Solution(ctypes.Structure):
    """Beginning of ``OSQPSolution``."""

    _fields_: ClassVar = [("x", ctypes.c_void_p), ("y", ctypes.c_void_p)]


class _Solver(ctypes.Structure):
    """Beginning of ``OSQPSolver``."""

    _fields_: ClassVar = [
        ("settings", ctypes.c_void_p),
        ("solution", ctypes.POINTER(_Solution)),
        ("info", ctypes.POINTER(_Info)),
    ]


FUNCTIONS = ("update_data_mat", "update_data_vec", "warm_start", "update_settings", "solve")
UPDATE_MATRIX, UPDATE_VECTORS, WARM_START, UPDATE_SETTINGS, SOLVE, SOLVER, SETTINGS, ARRAYS = range(8)
"""Places in ``CompiledWorkspace.addresses``: functions of OSQP, its structures, then A, q, l, u, x, y as loaded."""

Addresses = npt.NDArray[np.int64]

MAX_ITER, EPS_ABS = _Settings.max_iter.offset // 4, _Settings.eps_abs.offset // 8
"""Places in the settings, seen as integers and as floating-point numbers."""
STATUS_VAL, ITER = _Info.status_val.offset // 4, _Info.iter.offset // 4
PRIM_RES, DUAL_RES = _Info.prim_res.offset // 8, _Info.dual_res.offset // 8
"""Places in the statistics, seen in the same two ways."""


class CompiledWorkspace(Workspace):
    """Workspace of OSQP's C functions, called from compiled code.

    The addresses are an argument of that code: with constant addresses it could not be cached.
    """

    def __init__(self, P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> None:  # noqa: E741
        """Set up OSQP. Raises any exception if the extension has another interface: see ``c_functions_work``."""
        library = _library()
        upper, rows = _upper(P), _copy(A)
        self._sizes = n, m, _ = rows.shape[1], rows.shape[0], rows.nnz
        self._settings = _default_settings(library)  # OSQP copies them when they are updated
        for name, value in settings.items():
            setattr(self._settings, name, value)
        solver = ctypes.POINTER(_Solver)()
        matrices = [_new_csc(library, matrix) for matrix in (upper, rows)]
        vectors = [_contiguous(values, length) for values, length in ((q, n), (l, m), (u, m))]
        q_at, l_at, u_at = (_address(vector) for vector in vectors)
        own = ctypes.byref(self._settings)
        error = library.osqp_setup(ctypes.byref(solver), matrices[0], q_at, matrices[1], l_at, u_at, m, n, own)
        for matrix in matrices:
            library.OSQPCscMatrix_free(matrix)
        _check(error)
        weakref.finalize(self, library.osqp_cleanup, solver)
        functions = [ctypes.cast(getattr(library, f"osqp_{name}"), ctypes.c_void_p).value for name in FUNCTIONS]
        places = ctypes.addressof(solver.contents), ctypes.addressof(self._settings)
        self.addresses: Addresses = np.array([*functions, *places, *[0] * 6], dtype=np.int64)
        info, solution = ctypes.addressof(solver.contents.info.contents), solver.contents.solution.contents
        size = ctypes.sizeof(_Settings), ctypes.sizeof(_Info)
        self._memory = (
            _view(places[1], INT, size[0] // 4), _view(places[1], FLOAT, size[0] // 8),
            _view(info, INT, size[1] // 4), _view(info, FLOAT, size[1] // 8),
        )  # fmt: skip
        self.x, self.y = _view(solution.x, FLOAT, n), _view(solution.y, FLOAT, m)
        self._loaded: tuple[Array, ...] = ()

    def load(self, numbers: QpNumbers, x: Array, y: Array) -> None:
        """Replace all numbers (see ``Workspace``).

        Parameters
        ----------
        numbers : entries of A, q (n,), l and u (m,).
        x, y : (n,) and (m,) first guess, primal and dual.
        """
        if not (self._loaded and numbers.A is self._loaded[0] and x is self._loaded[4] and y is self._loaded[5]):
            n, m, entries = self._sizes
            lengths = (entries, n, m, m, n, m)
            self._loaded = tuple(map(_contiguous, (*numbers, x, y), lengths))
            self.addresses[ARRAYS:] = [_address(values) for values in self._loaded]
        _check(_load(self.addresses))

    def solve(self, iterations: int, tolerance: float) -> OsqpReport:
        """Solve the problem (see ``Workspace``).

        Parameters
        ----------
        iterations : largest number of iterations.
        tolerance : absolute residuals at which the solve ends.
        """
        status, took, primal, dual = _solve(self.addresses, *self._memory, iterations, tolerance)
        return OsqpReport(_status(status), took, primal, dual)


@jit
def _load(at: Addresses) -> int:
    """Pass the arrays to OSQP; return its first error, or 0."""
    A, q, l, u, x, y = at[ARRAYS], at[ARRAYS + 1], at[ARRAYS + 2], at[ARRAYS + 3], at[ARRAYS + 4], at[ARRAYS + 5]  # noqa: E741
    error = call_c(at[UPDATE_MATRIX], (at[SOLVER], 0, 0, 0, A, 0, 0))
    if error == 0:
        error = call_c(at[UPDATE_VECTORS], (at[SOLVER], q, l, u))
    if error == 0:
        error = call_c(at[WARM_START], (at[SOLVER], x, y))
    return error


@jit
def _solve(
    at: Addresses,
    int_settings: npt.NDArray[np.int32],
    float_settings: Array,
    int_info: npt.NDArray[np.int32],
    float_info: Array,
    iterations: int,
    tolerance: float,
) -> tuple[int, int, float, float]:
    """Solve; return OSQP's status, the iterations, and the primal and the dual residual."""
    if int_settings[MAX_ITER] != iterations or float_settings[EPS_ABS] != tolerance:
        int_settings[MAX_ITER], float_settings[EPS_ABS] = iterations, tolerance
        call_c(at[UPDATE_SETTINGS], (at[SOLVER], at[SETTINGS]))
    call_c(at[SOLVE], (at[SOLVER],))
    return int_info[STATUS_VAL], int_info[ITER], float_info[PRIM_RES], float_info[DUAL_RES]


class PublicWorkspace(Workspace):
    """Workspace of OSQP's public wrapper: the same numbers, more slowly."""

    def __init__(self, P: csc_array, q: Array, A: csc_array, l: Array, u: Array, settings: Settings) -> None:  # noqa: E741
        """Set up OSQP; arguments as in ``make_workspace``."""
        upper, rows = _upper(P), _copy(A)
        self._sizes = rows.shape[1], rows.shape[0], rows.nnz
        self._solver = osqp.OSQP(algebra="builtin")
        self._solver.setup(upper, q.copy(), rows, l.copy(), u.copy(), **dict(settings))
        self.x, self.y = np.zeros(self._sizes[0]), np.zeros(self._sizes[1])

    def load(self, numbers: QpNumbers, x: Array, y: Array) -> None:
        """Replace all numbers (see ``Workspace``).

        Parameters
        ----------
        numbers : entries of A, q (n,), l and u (m,).
        x, y : (n,) and (m,) first guess, primal and dual.
        """
        n, m, entries = self._sizes
        A, q, l, u, x, y = map(_contiguous, (*numbers, x, y), (entries, n, m, m, n, m))  # noqa: E741
        _check(int((l > u).any()))  # the wrapper would continue with the old bounds
        self._solver.update(Ax=A.copy())  # the wrapper keeps the array itself
        self._solver.update(q=q, l=l, u=u)
        self._solver.warm_start(x=x, y=y)

    def solve(self, iterations: int, tolerance: float) -> OsqpReport:
        """Solve the problem (see ``Workspace``).

        Parameters
        ----------
        iterations : largest number of iterations.
        tolerance : absolute residuals at which the solve ends.
        """
        self._solver.update_settings(max_iter=iterations, eps_abs=tolerance)
        result = self._solver.solve(raise_error=False)
        self.x, self.y, info = np.array(result.x), np.array(result.y), result.info
        return OsqpReport(_status(int(info.status_val)), int(info.iter), float(info.prim_res), float(info.dual_res))


@functools.cache
def c_functions_work() -> bool:
    """Return True if the C functions have this interface and the wrapper's results: tested once, on a small QP."""
    if not metadata.version("osqp").startswith(KNOWN):  # its structures may have another layout in memory
        return False
    try:
        ours, public = _exercise(CompiledWorkspace), _exercise(PublicWorkspace)
        return all(np.array_equal(a, b) for a, b in zip(ours, public, strict=True))
    except Exception:  # another interface can fail in any way, and the wrapper replaces it
        return False


def _exercise(kind: type[CompiledWorkspace] | type[PublicWorkspace]) -> list[Array]:
    """Make every call, and return the results."""
    P, A = csc_array(np.array([[2.0, 0.5], [0.5, 1.0]])), csc_array(np.array([[1.0, 1.0], [1.0, -1.0]]))
    bound = np.array([1.0, 0.3])
    tried = kind(P, np.array([1.0, -2.0]), A, -bound, bound, {**BASE_SETTINGS, "check_termination": 1, "eps_abs": 1e-6})
    results = []
    numbers = QpNumbers(np.array([1.0, 1.1, 0.9, -1.2]), np.array([-3.0, 0.7]), -2.0 * bound, 0.5 * bound)
    for limits in ((4000, 1e-6), (200, 1e-9)):
        report = tried.solve(*limits)
        results += [tried.x.copy(), tried.y.copy(), np.array([report.status is SolveStatus.SOLVED, *report[1:]])]
        tried.load(numbers, np.array([0.2, 0.1]), np.array([0.0, 0.4]))
    return results


def _library() -> ctypes.CDLL:
    """Return the extension as a C library, with the types of what Python calls."""
    from osqp import ext_builtin

    library = ctypes.CDLL(ext_builtin.__file__)
    pointer = ctypes.c_void_p
    library.OSQPCscMatrix_new.restype = pointer
    library.OSQPCscMatrix_new.argtypes = [INT, INT, INT, pointer, pointer, pointer]
    library.osqp_setup.argtypes = [pointer] * 6 + [INT, INT, pointer]
    for name in ("OSQPCscMatrix_free", "osqp_set_default_settings", "osqp_cleanup"):
        getattr(library, name).argtypes = [pointer]
    return library


def _default_settings(library: ctypes.CDLL) -> _Settings:
    """Return OSQP's defaults. Raises ``ValueError`` if the layout in memory is not that of this OSQP."""
    from osqp import ext_builtin

    room = (_Settings * 4)()  # a longer structure must not be written beyond its end
    library.osqp_set_default_settings(ctypes.byref(room))
    public = ext_builtin.OSQPSettings()
    ext_builtin.osqp_set_default_settings(public)
    own = _Settings.from_buffer_copy(room)
    for name in (field[0] for field in _Settings._fields_):
        if hasattr(public, name) and float(getattr(public, name)) != float(getattr(own, name)):
            raise ValueError(f"OSQP's settings have another layout: {name}")
    return own


def _new_csc(library: ctypes.CDLL, matrix: csc_matrix) -> int:
    """Return a C matrix that shares the memory of ``matrix``."""
    parts = (_address(part) for part in (matrix.data, matrix.indices, matrix.indptr))
    new: int = library.OSQPCscMatrix_new(*matrix.shape, matrix.nnz, *parts)
    return new


def _view(address: int, kind: type[ctypes.c_int32 | ctypes.c_double], length: int) -> Any:
    """Return the numbers at an address; their owner must live as long as they."""
    return np.ctypeslib.as_array((kind * length).from_address(address))


def _address(values: npt.NDArray[Any]) -> int:
    """Return the address of contiguous numbers."""
    return int(values.ctypes.data)


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
