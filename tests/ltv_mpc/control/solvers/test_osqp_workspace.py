"""OSQP by its C functions and by its public wrapper: the same numbers, bit for bit, and the same refusals."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from scipy.sparse import csc_array

from ltv_mpc.control.qp.sparse import QpNumbers
from ltv_mpc.control.solvers import osqp_workspace
from ltv_mpc.control.solvers.osqp_workspace import (
    BASE_SETTINGS,
    CompiledWorkspace,
    PublicWorkspace,
    c_functions_work,
    make_workspace,
)
from ltv_mpc.messages import SolveStatus

N, M = 6, 9
SETTINGS = {**BASE_SETTINGS, "rho": 0.1, "check_termination": 1}
LIMITS = 4000, 1e-7
"""Iterations and tolerance."""
KINDS = pytest.mark.parametrize("kind", [CompiledWorkspace, PublicWorkspace])


def problem(seed):
    """P, q, A, l, u without a zero in P or A: always the same pattern."""
    rng = np.random.default_rng(seed)
    root = rng.uniform(0.5, 1.5, (N, N))
    A = rng.uniform(0.5, 1.5, (M, N)) * rng.choice([-1, 1], (M, N))
    centre = A @ rng.normal(size=N)
    return csc_array(root @ root.T), rng.normal(size=N), csc_array(A), centre - 1.0, centre + 1.0


def numbers(seed):
    """Return what ``load`` takes of a problem."""
    _, q, A, low, high = problem(seed)
    return QpNumbers(A.data, q, low, high)


def cycles(kind):
    """Everything that a series of cycles reads."""
    solver = kind(*problem(0), SETTINGS)
    seen = []
    for seed in range(1, 6):
        rng = np.random.default_rng(seed)
        solver.load(numbers(seed), rng.normal(size=N), rng.normal(size=M))
        for _ in range(2 if seed == 3 else 1):  # the second goes on where the first ended
            seen += [*solver.solve(10 if seed == 3 else 4000, 1e-7), solver.x.copy(), solver.y.copy()]
    return seen


def test_both_ways_give_the_same_bit_for_bit():
    ours, public = cycles(CompiledWorkspace), cycles(PublicWorkspace)
    assert {SolveStatus.SOLVED, SolveStatus.ITERATION_LIMIT} <= {x for x in ours if isinstance(x, SolveStatus)}
    for a, b in zip(ours, public, strict=True):
        np.testing.assert_array_equal(a, b)


@KINDS
def test_an_update_is_worth_a_new_setup(kind):
    P, q, A, low, high = problem(1)
    answers = []
    for solver in (kind(P, *problem(0)[1:], SETTINGS), kind(P, q, A, low, high, SETTINGS)):
        solver.load(numbers(1), np.zeros(N), np.zeros(M))
        assert solver.solve(*LIMITS).status is SolveStatus.SOLVED
        answers.append(solver.x.copy())
    np.testing.assert_allclose(answers[0], answers[1], atol=1e-9)


@KINDS
def test_what_it_was_given_stays_the_caller_s(kind):
    P, q, A, low, high = problem(0)
    given = [P.data, q, A.data, low, high]
    before = [values.copy() for values in given]
    solver = kind(P, q, A, low, high, SETTINGS)
    solver.solve(*LIMITS)
    loaded = QpNumbers(problem(2)[2].data.copy(), 2.0 * q, low, high)
    solver.load(loaded, np.zeros(N), np.zeros(M))
    loaded.A[:] = np.nan
    solver.solve(*LIMITS)
    assert np.isfinite(solver.x).all()
    for values, copy in zip(given, before, strict=True):
        np.testing.assert_array_equal(values, copy)


@KINDS
def test_arrays_that_are_refilled_are_read_again(kind):
    """The compiled one checks an array once, and keeps its address."""
    solver, of, x, y = kind(*problem(0), SETTINGS), numbers(1), np.zeros(N), np.zeros(M)
    answers = []
    for seed in (1, 2):
        for values, new in zip(of, numbers(seed), strict=True):
            values[:] = new
        solver.load(of, x, y)
        solver.solve(*LIMITS)
        answers.append(solver.x.copy())
        fresh = kind(problem(0)[0], *problem(seed)[1:], SETTINGS)
        fresh.solve(*LIMITS)
        np.testing.assert_allclose(answers[-1], fresh.x, atol=1e-5)
    assert np.abs(answers[1] - answers[0]).max() > 0.1


@KINDS
def test_any_layout_is_read_right_and_a_wrong_length_is_refused(kind):
    """C alone would read wrong numbers, or past the end."""
    answers = []
    exact = [np.round(values * 64) / 64 for values in numbers(1)]  # exact in any type
    for layout in (np.array, lambda x: np.repeat(x, 2)[::2], lambda x: np.array(x, dtype=np.float32)):
        solver = kind(*problem(0), SETTINGS)
        solver.load(QpNumbers(*map(layout, exact)), layout(np.ones(N)), layout(np.ones(M)))
        solver.solve(*LIMITS)
        answers.append(solver.x.copy())
    for answer in answers[1:]:
        np.testing.assert_array_equal(answer, answers[0])
    good = [*numbers(1), np.ones(N), np.ones(M)]
    for i in range(len(good)):
        *wrong, x, y = [*good[:i], good[i][:-1].copy(), *good[i + 1 :]]
        with pytest.raises(ValueError, match=r"expected \d+ numbers"):
            solver.load(QpNumbers(*wrong), x, y)


@KINDS
def test_bounds_that_contradict_each_other_are_rejected(kind):
    solver = kind(*problem(0), SETTINGS)
    with pytest.raises(ValueError, match="rejected"):
        solver.load(numbers(1)._replace(l=np.ones(M), u=-np.ones(M)), np.ones(N), np.ones(M))


@KINDS
def test_ctrl_c_while_osqp_solves_reaches_whoever_waits_for_it(kind, request):
    """OSQP puts its own handler in place for as long as it solves."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs are to ignore it
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    solver = kind(*problem(0), {**SETTINGS, "check_termination": 0})
    solver.solve(1, 1e-300)  # compiles
    interrupt = f"import os, time; time.sleep(0.3); os.kill({os.getpid()}, {int(signal.SIGINT)})"
    with subprocess.Popen([sys.executable, "-c", interrupt]), pytest.raises(KeyboardInterrupt):
        solver.solve(2_000_000_000, 1e-300)


def test_the_c_functions_are_used_where_they_work():
    assert c_functions_work()
    assert isinstance(make_workspace(*problem(0), SETTINGS), CompiledWorkspace)


library = osqp_workspace._library


class OtherLayout:
    """Library whose settings begin with another number."""

    def __init__(self) -> None:
        self.real = library()

    def __getattr__(self, name):
        return getattr(self.real, name)

    def osqp_set_default_settings(self, at):
        self.real.osqp_set_default_settings(at)
        room = bytes(at._obj)
        ctypes.memmove(at, b"\0\0\0\0" + room[:-4], len(room))


class OtherNumbers(OtherLayout):
    """Library that takes the point to start from as the vectors."""

    osqp_set_default_settings = property(lambda self: self.real.osqp_set_default_settings)
    osqp_update_data_vec = property(lambda self: self.real.osqp_warm_start)


def renamed():
    """Fail as a library in which a function has another name."""
    raise AttributeError("osqp_setup")


BROKEN = {"renamed": renamed, "other layout": OtherLayout, "other numbers": OtherNumbers}


@pytest.mark.parametrize("broken", ["missing", *BROKEN])
def test_the_wrapper_steps_in_for_an_extension_that_changed(broken, monkeypatch):
    expected = cycles(make_workspace)
    if broken == "missing":
        monkeypatch.setitem(sys.modules, "osqp.ext_builtin", None)
        monkeypatch.delattr("osqp.ext_builtin", raising=False)
    else:
        monkeypatch.setattr(osqp_workspace, "_library", BROKEN[broken])
    c_functions_work.cache_clear()
    try:
        assert not c_functions_work()
        if broken != "missing":  # the wrapper itself stands on the extension
            assert isinstance(make_workspace(*problem(0), SETTINGS), PublicWorkspace)
            for ours, theirs in zip(cycles(make_workspace), expected, strict=True):
                np.testing.assert_array_equal(ours, theirs)
    finally:
        c_functions_work.cache_clear()
