"""The partially condensed QP: its optimum is the sparse one's for any length of its blocks."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control.config import Weights
from ltv_mpc.control.grid import knots
from ltv_mpc.control.qp.partial import PartialForm
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, equidistant, motion, optimum, precise, unlike_any_motion

WEIGHTS = Weights()


@pytest.mark.parametrize("limits", [LIMITS, LOWERED], ids=["box", "lowered box"])
@pytest.mark.parametrize(("stages", "block"), [(1, 5), (2, 1), (7, 3), (17, 5), (17, 17), (34, 5)])
def test_its_optimum_is_that_of_the_sparse_qp(stages, block, limits):
    form = PartialForm(equidistant(stages), limits, WEIGHTS, block)
    for seed in range(3):
        lin, target = motion(seed, stages, gap=0.02)
        assert form.build(lin, target)
        ours, _ = form.commands(lin, precise(form.problem()))
        np.testing.assert_allclose(ours, optimum(lin, target, limits, WEIGHTS), atol=1e-6)


@pytest.mark.parametrize("block", [1, 2, 3, 6])
@pytest.mark.parametrize("t", [equidistant(6), knots(6, 13.0)], ids=["equidistant", "growing"])
def test_no_number_of_sensitivities_and_knots_is_left_out(t, block):
    weights = Weights(
        position_per_m2=1.3,
        terminal_position_per_m2=7.0,
        terminal_velocity_s2_per_m2=11.0,
        thrust=0.17,
        thrust_change=0.05,
    )
    form = PartialForm(t, LIMITS, weights, block)
    for seed in range(3):
        lin, target = unlike_any_motion(seed, 6)
        form.build(lin, target)
        ours, _ = form.commands(lin, precise(form.problem()))
        np.testing.assert_allclose(ours, optimum(lin, target, LIMITS, weights, t), atol=1e-6)


def test_blocks_cover_the_horizon_and_are_as_long_as_was_asked():
    assert PartialForm(equidistant(17), LIMITS, WEIGHTS, 5).ends.tolist() == [0, 6, 11, 17]
    assert PartialForm(equidistant(3), LIMITS, WEIGHTS, 5).ends.tolist() == [0, 3]
    for stages in (34, 68, 136):
        lengths = np.diff(PartialForm(equidistant(stages), LIMITS, WEIGHTS, 5).ends)
        assert lengths.sum() == stages
        assert set(lengths) <= {4, 5, 6}


def test_unknowns_without_constraints_are_at_their_optimum_with_duals_of_zero():
    """What the change of the origin is for: zero is the first guess of the dynamics' duals."""
    lin, target = motion(2, 17, gap=0.02)
    form = PartialForm(equidistant(17), LIMITS, WEIGHTS)
    form.build(lin, target)
    np.testing.assert_array_equal(form.problem().q[: form.states], 0.0)
    np.testing.assert_array_equal(form.problem().l[: form.states], 0.0)


def test_rows_are_scaled_as_asked():
    lin, target = motion(2, 9)
    form = PartialForm(equidistant(9), LIMITS, WEIGHTS, 4)
    form.build(lin, target)
    scale = np.random.default_rng(0).uniform(0.5, 2.0, form.rows)
    A = np.empty(form.entries)
    form.scaled_rows(scale, A)
    np.testing.assert_allclose(form.matrices(A)[1].toarray(), scale[:, None] * form.problem().A.toarray())


@pytest.mark.parametrize("field", ["X", "U", "C", "Phi", "A", "B0", "B1"])
def test_an_input_that_is_not_finite_is_seen(field):
    form = PartialForm(equidistant(5), LIMITS, WEIGHTS)
    lin, target = motion(3, 5)
    broken = getattr(lin, field).copy()
    broken[-1] = np.inf
    assert not form.build(lin._replace(**{field: broken}), target)
