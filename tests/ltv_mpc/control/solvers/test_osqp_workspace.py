"""OSQP by its extension and by its public wrapper: the same numbers, bit for bit, and the same refusals."""

from __future__ import annotations

import os
import signal
import sys
import threading

import numpy as np
import pytest
from osqp import ext_builtin
from scipy.sparse import csc_array

from ltv_mpc.control.solvers.osqp_workspace import (
    BASE_SETTINGS,
    ExtensionWorkspace,
    PublicWorkspace,
    extension_works,
    make_workspace,
)
from ltv_mpc.messages import SolveStatus

N, M = 6, 9
SETTINGS = {**BASE_SETTINGS, "rho": 0.1, "max_iter": 4000, "eps_abs": 1e-7, "check_termination": 1}
KINDS = pytest.mark.parametrize("kind", [ExtensionWorkspace, PublicWorkspace])


def problem(seed):
    """P, q, A, l, u without a zero in P or A: always the same pattern."""
    rng = np.random.default_rng(seed)
    root = rng.uniform(0.5, 1.5, (N, N))
    A = rng.uniform(0.5, 1.5, (M, N)) * rng.choice([-1, 1], (M, N))
    centre = A @ rng.normal(size=N)
    return csc_array(root @ root.T), rng.normal(size=N), csc_array(A), centre - 1.0, centre + 1.0


def cycles(kind):
    """Everything that a series of cycles reads."""
    solver = kind(*problem(0), SETTINGS)
    seen = []
    for seed in range(1, 6):
        _, q, A, low, high = problem(seed)
        solver.update_vectors(q, low, high)
        solver.update_matrix(A.data)
        solver.set_limits(10 if seed == 3 else 4000, 1e-7)
        rng = np.random.default_rng(seed)
        solver.warm_start(rng.normal(size=N), rng.normal(size=M))
        seen += [solver.solve(), *solver.solution(), solver.statistics()]
        if seed == 3:  # goes on where it ended
            seen += [solver.solve(), *solver.solution(), solver.statistics()]
    return seen


def test_both_ways_give_the_same_bit_for_bit():
    raw, public = cycles(ExtensionWorkspace), cycles(PublicWorkspace)
    assert {SolveStatus.SOLVED, SolveStatus.ITERATION_LIMIT} <= {x for x in raw if isinstance(x, SolveStatus)}
    for ours, theirs in zip(raw, public, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@KINDS
def test_an_update_is_worth_a_new_setup(kind):
    P, q, A, low, high = problem(1)
    updated, fresh = kind(P, *problem(0)[1:], SETTINGS), kind(P, q, A, low, high, SETTINGS)
    updated.update_vectors(q, low, high)
    updated.update_matrix(A.data)
    answers = []
    for solver in (updated, fresh):
        solver.warm_start(np.zeros(N), np.zeros(M))
        assert solver.solve() is SolveStatus.SOLVED
        answers.append(solver.solution()[0])
    np.testing.assert_allclose(answers[0], answers[1], atol=1e-9)


@KINDS
def test_what_it_was_given_stays_the_caller_s(kind):
    P, q, A, low, high = problem(0)
    given = [P.data, q, A.data, low, high]
    before = [values.copy() for values in given]
    solver = kind(P, q, A, low, high, SETTINGS)
    solver.solve()
    first = solver.solution()[0]
    kept = first.copy()
    data = problem(2)[2].data.copy()
    solver.update_matrix(data)
    data[:] = np.nan
    solver.update_vectors(2.0 * q, low, high)
    solver.solve()
    assert np.isfinite(solver.solution()[0]).all()
    np.testing.assert_array_equal(first, kept)
    for values, copy in zip(given, before, strict=True):
        np.testing.assert_array_equal(values, copy)


@KINDS
def test_any_layout_is_read_right_and_a_wrong_length_is_refused(kind):
    """The extension alone would read wrong numbers, or past the end."""
    answers = []
    for layout in (np.array, lambda x: np.repeat(x, 2)[::2], lambda x: np.array(x, dtype=np.float32)):
        solver = kind(*problem(0), SETTINGS)
        q, low, high = (np.round(v * 64) / 64 for v in (problem(1)[1], *problem(1)[3:]))  # exact in any type
        solver.update_vectors(layout(q), layout(low), layout(high))
        solver.update_matrix(layout(np.round(problem(1)[2].data * 64) / 64))
        solver.warm_start(layout(np.ones(N)), layout(np.ones(M)))
        solver.solve()
        answers.append(solver.solution()[0])
    for answer in answers[1:]:
        np.testing.assert_array_equal(answer, answers[0])
    for short in (
        lambda: solver.update_vectors(np.ones(N - 1), np.ones(M), np.ones(M)),
        lambda: solver.update_vectors(np.ones(N), np.ones(M), np.ones(M + 1)),
        lambda: solver.update_matrix(np.ones(N * M - 1)),
        lambda: solver.warm_start(np.ones(N), np.ones(M - 1)),
    ):
        with pytest.raises(ValueError, match=r"expected \d+ numbers"):
            short()


@KINDS
def test_bounds_that_contradict_each_other_are_rejected(kind):
    solver = kind(*problem(0), SETTINGS)
    with pytest.raises(ValueError, match="rejected"):
        solver.update_vectors(np.ones(N), np.ones(M), -np.ones(M))


@KINDS
def test_ctrl_c_while_osqp_solves_reaches_whoever_waits_for_it(kind, request):
    """OSQP puts its own handler in place for as long as it solves."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs are to ignore it
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    solver = kind(*problem(0), {**SETTINGS, "max_iter": 2_000_000_000, "eps_abs": 1e-300, "check_termination": 0})
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        solver.solve()
    timer.join()


def test_the_extension_is_used_where_it_works():
    assert extension_works()
    assert isinstance(make_workspace(*problem(0), SETTINGS), ExtensionWorkspace)


class Renamed:
    """An extension whose call has another name."""

    OSQPSettings = ext_builtin.OSQPSettings
    CSC = ext_builtin.CSC


class Wrong(ext_builtin.OSQPSolver):
    """One that does something else with what it is given."""

    def update_data_vec(self, q, l, u):  # noqa: E741
        return super().update_data_vec(q=-q, l=l, u=u)


@pytest.mark.parametrize("broken", ["missing", "renamed", "other numbers"])
def test_the_wrapper_steps_in_for_an_extension_that_changed(broken, monkeypatch):
    expected = cycles(make_workspace)
    if broken == "missing":
        monkeypatch.setitem(sys.modules, "osqp.ext_builtin", None)
        monkeypatch.delattr("osqp.ext_builtin", raising=False)
    elif broken == "renamed":
        monkeypatch.setattr("osqp.ext_builtin", Renamed)
    else:
        module = type("Module", (), {**vars(ext_builtin), "OSQPSolver": Wrong})
        monkeypatch.setattr("osqp.ext_builtin", module)
    extension_works.cache_clear()
    try:
        assert not extension_works()
        if broken != "missing":  # the wrapper itself stands on the extension
            assert isinstance(make_workspace(*problem(0), SETTINGS), PublicWorkspace)
            for ours, theirs in zip(cycles(make_workspace), expected, strict=True):
                np.testing.assert_array_equal(ours, theirs)
    finally:
        extension_works.cache_clear()
