"""Warm restart: a filter continues from a checkpoint, and its covariance covers the gap."""

from functools import partial

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.checkpoint import belief_of, checkpoint_of, settings_of
from ltv_mpc.localisation.imu_dropout import VELOCITY_WALK
from ltv_mpc.localisation.publishing import CHECKPOINT_NS, SUBMERGED_M
from ltv_mpc.messages import Estimate, EstimatorState, FilterStatus, ImuSample, PressureDepth
from services.bus.wire import Header, decode, encode
from tests.ltv_mpc.localisation.dives import CONFIG as SHIPPED
from tests.ltv_mpc.localisation.dives import PAPER, REALISTIC, Run, S, dive, normalised

CONFIG = replace(SHIPPED, deepest_m=60.0)
GAP_NS = 3 * S


the_dive = partial(dive, REALISTIC, 4, duration_s=20.0)
"""The dive of this file: made once, and not where only its tests are collected."""


@pytest.fixture(scope="module")
def whole():
    """Twenty seconds of a dive without a gap."""
    return Run(the_dive().messages, config=CONFIG)


@pytest.fixture
def checkpoints(whole):
    return {state.t_ns: state for state in whole.of(EstimatorState)}


def restored(whole, died_ns, *, estimate=True, **changed):
    """Return the run of an estimator that replaces one that stopped at ``died_ns``, after the gap."""
    state = [state for state in whole.of(EstimatorState) if state.t_ns <= died_ns][-1]
    state = replace(state, estimate=whole.estimates[died_ns] if estimate else None, **changed)
    after = (m for m in the_dive().messages if m.t_ns > died_ns + GAP_NS)
    return Run(after, config=CONFIG, state=state)


def test_a_checkpoint_is_published_first_every_five_seconds_and_at_submergence(whole, checkpoints):
    under = next(t_ns for t_ns, e in whole.estimates.items() if e.depth_m > SUBMERGED_M)
    regular = [t_ns for t_ns in whole.estimates if t_ns % CHECKPOINT_NS == 0]
    assert list(checkpoints) == sorted({min(whole.estimates), under, *regular})


def test_a_state_that_no_message_holds_is_not_published():
    run = Run(dive(PAPER, 4, duration_s=6.0).messages, PAPER, replace(CONFIG, deepest_m=221.0))
    assert run.estimates
    assert run.of(EstimatorState) == []


def test_a_checkpoint_restores_the_filters_belief_to_the_bit_over_the_wire_too():
    filter_ = Run(the_dive().messages, config=CONFIG).estimator.filter
    filter_.belief.x[2] += 15.0
    filter_.correct(PressureDepth(t_ns=filter_.belief.t_ns, depth_m=float(filter_.belief.x[2])))
    t_ns, nothing = filter_.belief.t_ns + 10_000_000, (0.0, 0.0, 0.0)
    still = ImuSample(
        t_ns=t_ns, interval_ns=10_000_000, angular_rate_radps=nothing, specific_force_mps2=(0.0, 0.0, -9.8)
    )
    filter_.advance(t_ns, still)  # whose covariance is still where it was
    before = filter_.snapshot()
    checkpoint = checkpoint_of(filter_, settings_of(REALISTIC, CONFIG, None), 2)
    after = filter_.snapshot()
    assert (after.belief.P.tobytes(), after.pending_ns) == (before.belief.P.tobytes(), before.pending_ns)

    travelled, _ = decode(EstimatorState, encode(checkpoint, Header(epoch=1, sequence=0)))
    belief, own = belief_of(travelled, REALISTIC, CONFIG, None), filter_.propagated_belief()
    for name in ("x", "R", "mounting", "P"):
        assert getattr(belief, name).tobytes() == getattr(own, name).tobytes(), name
    assert (belief.t_ns, belief.epoch_t_ns, belief.layout) == (own.t_ns, own.epoch_t_ns, own.layout)


def test_a_checkpoint_of_other_settings_is_not_used(checkpoints):
    checkpoint, coarser = checkpoints[10 * S], replace(CONFIG, cell_m=2.0)
    assert belief_of(checkpoint, REALISTIC, coarser, None) is None
    assert belief_of(checkpoint, REALISTIC, replace(CONFIG, current_sd_mps=0.05), None) is None
    assert belief_of(checkpoint, PAPER, CONFIG, None) is None
    estimator = Run(the_dive().messages[:3], config=coarser, state=checkpoint).estimator
    assert estimator.account["checkpoint.other_settings"] == 1
    assert estimator.waiting_for != ""  # as if there were none


def test_a_warm_restart_under_water_is_immediate_and_consistent(whole):
    """Without a checkpoint it would wait for satellites. A gap of three seconds at seven times."""
    worst = []
    for died_ns in range(8 * S, 15 * S, S):
        run = restored(whole, died_ns)
        assert min(run.estimates) <= died_ns + GAP_NS + 2 * CONFIG.estimate_period_ns
        worst += [normalised(estimate, the_dive()) for estimate in run.estimates.values()]
        assert {report.status for report in run.reports.values()} == {FilterStatus.RESTARTED}
        assert all("checkpoint" in report.why for report in run.reports.values())
    assert max(worst) < 28.5  # chi-square of 5 degrees of freedom, 3e-5
    assert not Run((m for m in the_dive().messages if m.t_ns > 10 * S), config=CONFIG).estimates


def test_measurements_after_the_gap_determine_the_displacement_within_it(whole):
    """A velocity at both ends: of q T^3 / 3 a quarter is left."""
    back = restored(whole, 10 * S).estimates
    grown = [e.covariance[0, 0] - whole.estimates[t_ns].covariance[0, 0] for t_ns, e in back.items()]
    T = (min(back) - 10 * S) * 1e-9
    assert grown[0] == pytest.approx(VELOCITY_WALK * T**3 / 3, rel=0.1)
    assert grown[-1] == pytest.approx(VELOCITY_WALK * T**3 / 12, rel=0.25)


def test_without_an_estimate_the_gap_begins_at_the_checkpoint(whole):
    before = whole.estimates[10 * S].covariance[0, 0]
    for known, T in ((True, 3.1), (False, 7.1)):
        first = next(iter(restored(whole, 14 * S, estimate=known).estimates.values()))
        assert first.covariance[0, 0] - before == pytest.approx(VELOCITY_WALK * T**3 / 3, rel=0.1)


def test_counts_of_reinitialisations_are_kept(whole):
    assert list(restored(whole, 15 * S, restarts=3).reports.values())[-1].restarts == 3


def test_a_restart_crosses_its_gap_as_the_filter_itself_crosses_a_dropout(whole):
    """The filter that was not replaced lacks the same messages."""
    lasting = Run((m for m in the_dive().messages if not 10 * S < m.t_ns <= 10 * S + GAP_NS), config=CONFIG)
    t_ns, restarted = next(iter(restored(whole, 10 * S).estimates.items()))
    other = lasting.estimates[t_ns]
    variances = (np.diagonal(one.covariance)[:4] for one in (restarted, other))  # of position and velocity
    np.testing.assert_allclose(*variances, rtol=0.01)
    assert (restarted.north_m, restarted.east_m) == pytest.approx((other.north_m, other.east_m), abs=0.005)
    assert restarted.heading_rad == pytest.approx(other.heading_rad, abs=0.01)  # sd 0.15


def test_a_warm_restart_skips_used_messages_and_keeps_the_last_uncertainty(whole, checkpoints):
    """Messages that were under way when it stopped, and an estimate less certain than the checkpoint."""
    uncertain = replace(whole.estimates[12 * S], covariance=np.diag([400.0, 900.0, 4.0, 9.0, 0.25, 1e-6]))
    state = replace(checkpoints[10 * S], estimate=uncertain)
    after = (m for m in the_dive().messages if 11.5 * S < m.t_ns < 12.25 * S)
    first = Run(after, config=CONFIG, state=state).of(Estimate)[0]
    assert first.t_ns == 12 * S + CONFIG.estimate_period_ns
    assert first.covariance[0, 0] > 400.0
    assert first.covariance[1, 1] > 900.0


def test_repeating_past_operations_reports_progress():
    """Otherwise the supervisor would take it for a hang."""
    signs = []
    estimator = Estimator(REALISTIC, CONFIG, progress=lambda: signs.append(None))
    Run((m for m in the_dive().messages if m.t_ns <= 3 * S), estimator=estimator)
    before = len(signs)
    Run([PressureDepth(t_ns=2 * S + 5_000_000, depth_m=0.4)], estimator=estimator)
    assert len(signs) - before > 90  # a second of samples
