"""Warm restart: a filter continues from a checkpoint, and its covariance covers the gap."""

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import roll_pitch_heading, wrap_angle
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.checkpoint import belief_of, checkpoint_of, settings_of
from ltv_mpc.localisation.filter.state import POSITION, VELOCITY
from ltv_mpc.localisation.imu_dropout import TURN_WALK, VELOCITY_WALK
from ltv_mpc.localisation.publishing import CHECKPOINT_NS, SUBMERGED_M
from ltv_mpc.localisation.reinitialisation import RESTARTED_NS
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.warm_restart import WarmRestart
from ltv_mpc.messages import Estimate, EstimatorState, FilterStatus, ImuSample, LocalisationReport, PressureDepth
from ltv_mpc.node import ReceivedMessage
from services.bus.wire import Header, decode, encode

SUITE = SensorConfig.load("realistic")
CONFIG = msgspec.structs.replace(EstimatorConfig(), deepest_m=60.0, kept_m=0.0)
S = 1_000_000_000
GAP_NS = 3 * S


def said(estimator, messages, inbox_of, *, state=None):
    first = [] if state is None else [ReceivedMessage(state, 1, 0, state.t_ns)]
    out = []
    for message in messages:
        out += estimator.step(message.t_ns, [*first, *inbox_of(message)])
        first = []
    return out


def of(kind, signals):
    return [signal for signal in signals if isinstance(signal, kind)]


@pytest.fixture(scope="module")
def dived(make_dive, inbox_of):
    """Twenty seconds of a dive, and the output of an estimator without a gap."""
    dive = make_dive(SUITE, 4, duration_s=20.0)
    estimator = Estimator(SUITE, CONFIG)
    return dive, said(estimator, dive.messages, inbox_of), estimator


def wrong_by(estimate, dive):
    """Return the errors in north, east, velocity north, east and heading."""
    k = dive.at(estimate.t_ns)
    heading = roll_pitch_heading(dive.R[k])[2]
    found = [estimate.north_m, estimate.east_m, estimate.velocity_north_mps, estimate.velocity_east_mps]
    true = [*dive.position[k, :2], *dive.velocity[k, :2]]
    return np.array([*np.subtract(found, true), wrap_angle(estimate.heading_rad - heading)])


def restored(dive, outputs, inbox_of, died_ns, *, estimate=True):
    """Return the output of an estimator that replaces one that stopped at ``died_ns``, after the gap."""
    before = [signal for signal in outputs if signal.t_ns <= died_ns]
    newest = of(Estimate, before)[-1] if estimate else None
    state = msgspec.structs.replace(of(EstimatorState, before)[-1], estimate=newest)
    after = [m for m in dive.messages if m.t_ns > died_ns + GAP_NS]
    return said(Estimator(SUITE, CONFIG), after, inbox_of, state=state)


def test_a_checkpoint_is_published_first_every_five_seconds_and_at_submergence(dived):
    _, outputs, _ = dived
    times = [checkpoint.t_ns for checkpoint in of(EstimatorState, outputs)]
    estimates = of(Estimate, outputs)
    under = next(e.t_ns for e in estimates if e.depth_m > SUBMERGED_M)
    regular = [e.t_ns for e in estimates if e.t_ns % CHECKPOINT_NS == 0]
    assert times == sorted({estimates[0].t_ns, under, *regular})


def test_a_checkpoint_restores_the_filters_belief_to_the_bit_over_the_wire_too(dived):
    _, _, estimator = dived
    filter_ = estimator.filter
    filter_.belief.x[2] += 15.0  # deep enough for the window of depths to have gone down
    filter_.correct(PressureDepth(t_ns=filter_.belief.t_ns, depth_m=float(filter_.belief.x[2])))
    still = ImuSample(
        t_ns=filter_.belief.t_ns + 10_000_000,
        interval_ns=10_000_000,
        angular_rate_radps=(0.0, 0.0, 0.0),
        specific_force_mps2=(0.0, 0.0, -9.8),
    )
    filter_.advance(still.t_ns, still)  # whose covariance is still where it was
    settings = settings_of(SUITE, CONFIG, None)
    before = filter_.snapshot()
    checkpoint = checkpoint_of(filter_, settings, 2)
    after = filter_.snapshot()
    assert (after.belief.P.tobytes(), after.pending_ns) == (before.belief.P.tobytes(), before.pending_ns)

    travelled, _ = decode(EstimatorState, encode(checkpoint, Header(epoch=1, sequence=0)))
    belief = belief_of(travelled, SUITE, CONFIG, None)
    filter_.propagate_covariance()
    own = filter_.belief
    filter_.restore(before)
    for name in ("x", "R", "mounting", "P"):
        assert getattr(belief, name).tobytes() == getattr(own, name).tobytes(), name
    assert (belief.t_ns, belief.epoch_t_ns, belief.layout) == (own.t_ns, own.epoch_t_ns, own.layout)
    assert (belief.column.first, belief.column.walked) == (own.column.first, own.column.walked)
    assert (belief.column.observed == own.column.observed).all()
    assert list(belief.column.dropped) == list(own.column.dropped)
    assert len(own.column.dropped) > 0  # else this shows nothing
    for node, link in own.column.dropped.items():
        other = belief.column.dropped[node]
        assert all(np.array_equal(getattr(link, name), getattr(other, name)) for name in link.__struct_fields__)
    assert np.array_equal(belief.column.prior.covariance(slice(None)), own.column.prior.covariance(slice(None)))


def test_a_checkpoint_of_other_settings_is_not_used(dived, inbox_of):
    dive, outputs, _ = dived
    checkpoint = of(EstimatorState, outputs)[-1]
    coarser = msgspec.structs.replace(CONFIG, cell_m=2.0)
    assert belief_of(checkpoint, SUITE, coarser, None) is None
    assert belief_of(checkpoint, SUITE, msgspec.structs.replace(CONFIG, current_sd_mps=0.05), None) is None
    assert belief_of(checkpoint, SensorConfig.load("paper"), CONFIG, None) is None
    assert belief_of(msgspec.structs.replace(checkpoint, first_grid_point=60), SUITE, CONFIG, None) is None
    estimator = Estimator(SUITE, coarser)
    said(estimator, dive.messages[:3], inbox_of, state=checkpoint)
    assert estimator.account["checkpoint.other_settings"] == 1
    assert estimator.waiting_for != ""  # as if there were none


def test_a_warm_restart_under_water_is_immediate_and_consistent(dived, inbox_of):
    """Without a checkpoint it would wait for satellites. A gap of three seconds at seven times."""
    dive, outputs, _ = dived
    worst = []
    for died_ns in range(8 * S, 15 * S, S):
        back = restored(dive, outputs, inbox_of, died_ns)
        estimates = of(Estimate, back)
        assert estimates[0].t_ns <= died_ns + GAP_NS + 2 * CONFIG.estimate_period_ns
        for estimate in estimates:
            d, P = wrong_by(estimate, dive), estimate.covariance[:5, :5]
            worst.append(d @ np.linalg.solve(P, d))
    assert max(worst) < 28.5  # chi-square of 5 degrees of freedom, 3e-5
    fresh = said(Estimator(SUITE, CONFIG), [m for m in dive.messages if m.t_ns > 10 * S], inbox_of)
    assert of(Estimate, fresh) == []


def test_measurements_after_the_gap_determine_the_displacement_within_it(dived, inbox_of):
    """A velocity at both ends: of q T^3 / 3 a quarter is left."""
    dive, outputs, _ = dived
    back = of(Estimate, restored(dive, outputs, inbox_of, 10 * S))
    unbroken = {e.t_ns: e.covariance[0, 0] for e in of(Estimate, outputs)}
    grown = [e.covariance[0, 0] - unbroken[e.t_ns] for e in back]
    T = (back[0].t_ns - 10 * S) * 1e-9
    assert grown[0] == pytest.approx(VELOCITY_WALK * T**3 / 3, rel=0.1)
    assert grown[-1] == pytest.approx(VELOCITY_WALK * T**3 / 12, rel=0.25)


def test_without_an_estimate_the_gap_begins_at_the_checkpoint(dived, inbox_of):
    dive, outputs, _ = dived
    died_ns = 14 * S
    assert of(EstimatorState, [s for s in outputs if s.t_ns <= died_ns])[-1].t_ns == 10 * S
    before = next(e for e in of(Estimate, outputs) if e.t_ns == 10 * S).covariance[0, 0]
    known, unknown = (
        of(Estimate, restored(dive, outputs, inbox_of, died_ns, estimate=known))[0].covariance[0, 0] - before
        for known in (True, False)
    )
    assert known == pytest.approx(VELOCITY_WALK * 3.1**3 / 3, rel=0.1)
    assert unknown == pytest.approx(VELOCITY_WALK * 7.1**3 / 3, rel=0.1)


def test_a_restart_is_reported_for_half_a_minute_and_counts_are_kept(dived, inbox_of):
    dive, outputs, _ = dived
    reports = of(LocalisationReport, restored(dive, outputs, inbox_of, 10 * S))
    assert {report.status for report in reports} == {FilterStatus.RESTARTED}
    assert RESTARTED_NS == 30 * S
    assert "checkpoint" in reports[0].why
    checkpoint = next(c for c in of(EstimatorState, outputs) if c.t_ns == 15 * S)
    checkpoint = msgspec.structs.replace(checkpoint, restarts=3)
    estimator = Estimator(SUITE, CONFIG)
    after = [m for m in dive.messages if m.t_ns > 16 * S]
    assert of(LocalisationReport, said(estimator, after, inbox_of, state=checkpoint))[-1].restarts == 3


def test_the_covariance_after_a_gap_is_that_of_the_closed_form(dived):
    """Position, velocity and heading by the closed form; level and bias are correlated as by levelling."""
    _, outputs, _ = dived
    checkpoint = of(EstimatorState, outputs)[-1]
    start = belief_of(checkpoint, SUITE, CONFIG, None)
    resumption = WarmRestart(SUITE, CONFIG, start, None)
    T = 2.0
    first_ns = checkpoint.t_ns + round(T * S)
    for k in range(25):
        resumption.take(
            ImuSample(
                t_ns=first_ns + k * 10_000_000,
                interval_ns=10_000_000,
                angular_rate_radps=(0.0, 0.0, 0.3 + float(start.x[11])),
                specific_force_mps2=(0.0, 0.0, -9.80665),
            )
        )
    belief, since = resumption.belief()
    assert belief.t_ns == first_ns
    assert len(since) == 24
    np.testing.assert_allclose(belief.x[POSITION], start.x[POSITION] + T * start.x[VELOCITY])
    F = np.eye(6)
    F[:3, 3:] = T * np.eye(3)
    q = VELOCITY_WALK * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
    np.testing.assert_allclose(belief.P[:6, :6], F @ start.P[:6, :6] @ F.T + np.kron(q, np.eye(3)), rtol=1e-12)
    turned = wrap_angle(roll_pitch_heading(belief.R)[2] - roll_pitch_heading(start.R)[2])
    assert turned == pytest.approx(T * 0.3 / 2, abs=1e-9)
    assert belief.P[8, 8] - start.P[8, 8] == pytest.approx(TURN_WALK * T**3 / 12)
    # tilt about north by the bias along the body's axes: phi = T_l R db
    T_l = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) / 9.80665
    np.testing.assert_allclose(belief.P[6:8, 12:15], T_l @ belief.R @ belief.P[12:15, 12:15], atol=1e-12)
    assert np.linalg.eigvalsh(belief.P)[0] > -1e-12
    imu = SUITE.imu
    for states, sd, tau_s in (
        (slice(9, 12), imu.gyro_bias_sd_radps, imu.gyro_bias_tau_s),
        (slice(12, 15), imu.accelerometer_bias_sd_mps2, imu.accelerometer_bias_tau_s),
    ):
        keep = math.exp(-T / tau_s)
        np.testing.assert_allclose(belief.x[states], keep * start.x[states])
        aged = keep**2 * start.P[states, states] + sd**2 * (1 - keep**2) * np.eye(3)
        np.testing.assert_allclose(belief.P[states, states], aged, rtol=1e-9, atol=1e-18)


def test_a_warm_restart_skips_used_messages_and_keeps_the_last_uncertainty(dived, inbox_of):
    """Messages that were under way when it stopped, and an estimate less certain than the checkpoint."""
    dive, outputs, _ = dived
    before = [s for s in outputs if s.t_ns <= 12 * S]
    checkpoint, estimate = of(EstimatorState, before)[-1], of(Estimate, before)[-1]
    doubtful = msgspec.structs.replace(estimate, covariance=np.diag([400.0, 900.0, 4.0, 9.0, 0.25, 1e-6]))
    state = msgspec.structs.replace(checkpoint, estimate=doubtful)
    after = [m for m in dive.messages if 11.5 * S < m.t_ns < 12.25 * S]
    first = of(Estimate, said(Estimator(SUITE, CONFIG), after, inbox_of, state=state))[0]
    assert first.t_ns == 12 * S + CONFIG.estimate_period_ns
    assert first.covariance[0, 0] > 400.0
    assert first.covariance[1, 1] > 900.0


def test_repeating_past_operations_reports_progress(dived, inbox_of):
    """Otherwise the supervisor would take it for a hang."""
    dive, _, _ = dived
    got_on = []
    estimator = Estimator(SUITE, CONFIG, progress=lambda: got_on.append(None))
    said(estimator, [m for m in dive.messages if m.t_ns <= 3 * S], inbox_of)
    before = len(got_on)
    said(estimator, [PressureDepth(t_ns=2 * S + 5_000_000, depth_m=0.4)], inbox_of)
    assert len(got_on) - before > 90  # a second of samples
