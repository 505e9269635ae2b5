"""The condensed QP: its optimum is the sparse one's, whatever the motion, its gaps and its start."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.control.config import Weights
from ltv_mpc.control.grid import knots
from ltv_mpc.control.horizon import not_finite
from ltv_mpc.control.qp.condensed import CondensedForm
from tests.ltv_mpc.control.problems import LIMITS, LOWERED, equidistant, motion, optimum, precise, unlike_any_motion

WEIGHTS = Weights()


@pytest.mark.parametrize("limits", [LIMITS, LOWERED], ids=["box", "lowered box"])
@pytest.mark.parametrize("stages", [1, 2, 17, 40])
def test_its_optimum_is_that_of_the_sparse_qp(stages, limits):
    form = CondensedForm(equidistant(stages), limits, WEIGHTS)
    for seed in range(4):
        lin, target = motion(seed, stages, gap=0.02)
        assert form.build(lin, target)
        ours, _ = form.commands(lin, precise(form.problem()))
        np.testing.assert_allclose(ours, optimum(lin, target, limits, WEIGHTS), atol=1e-6)


def test_the_lowered_box_leaves_starts_outside_of_it():
    starts = np.array([motion(seed, 17)[0].U[0] for seed in range(4)])
    assert (np.abs(starts) > LOWERED.high).any()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("t", [equidistant(6), knots(6, 13.0)], ids=["equidistant", "growing"])
def test_no_number_of_sensitivities_and_knots_is_left_out(t, seed):
    weights = Weights(
        position_per_m2=1.3,
        terminal_position_per_m2=7.0,
        terminal_velocity_s2_per_m2=11.0,
        thrust=0.17,
        thrust_change=0.05,
    )
    lin, target = unlike_any_motion(seed, 6)
    form = CondensedForm(t, LIMITS, weights)
    form.build(lin, target)
    ours, _ = form.commands(lin, precise(form.problem()))
    np.testing.assert_allclose(ours, optimum(lin, target, LIMITS, weights, t), atol=1e-6)


def test_a_cycle_leaves_nothing_to_the_next():
    used, fresh = (CondensedForm(equidistant(9), LIMITS, WEIGHTS) for _ in range(2))
    used.build(*unlike_any_motion(0, 9))
    for form in (used, fresh):
        form.build(*motion(1, 9, gap=0.1))
    for ours, theirs in ((used.H, fresh.H), (used.f, fresh.f), (used.lower, fresh.lower), (used.upper, fresh.upper)):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("field", ["X", "U", "C", "Phi", "A", "B0", "B1", "target"])
def test_an_input_that_is_not_finite_is_seen_and_named(field):
    form = CondensedForm(equidistant(5), LIMITS, WEIGHTS)
    lin, target = motion(3, 5)
    assert form.build(lin, target)
    broken = target if field == "target" else getattr(lin, field)
    broken = broken.copy()
    broken[-1] = np.nan
    if field == "target":
        target = broken
    else:
        lin = lin._replace(**{field: broken})
    assert not form.build(lin, target)
    assert not_finite(lin, target) == f"{field} is not finite from {len(broken) - 1} on"
