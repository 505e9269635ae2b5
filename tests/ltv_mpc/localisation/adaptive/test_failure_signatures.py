"""Failure signatures against a filter that receives the failure; filter/test_update.py has their gain."""

import msgspec
import numpy as np

from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.adaptive.glr_detector import STEP_NS, STEPS
from ltv_mpc.localisation.adaptive.process_noise import AdaptiveProcessNoise, NoiseLevel
from ltv_mpc.localisation.filter.state import VELOCITY, Belief, Layout
from ltv_mpc.messages import AdcpPing
from tests.ltv_mpc.localisation.dives import CONFIG, PAPER, Run, S, dive, with_water

LAYOUT = Layout.of(PAPER, CONFIG)


def test_the_antennas_clone_is_wrong_by_what_position_and_attitude_are():
    """P = E E^T holds before and after the clone."""
    belief = Belief.blank(LAYOUT, 0)
    belief.signatures = FailureSignatures.of(LAYOUT.size, 6)
    belief.signatures.error[:] = 0.1 * np.random.default_rng(0).standard_normal((LAYOUT.size, 6))
    belief.P = belief.signatures.error @ belief.signatures.error.T
    belief.clone_position((0.3, -0.2, 0.5))
    np.testing.assert_allclose(belief.P, belief.signatures.error @ belief.signatures.error.T, atol=1e-14)


def test_a_filter_that_hears_a_drift_is_off_by_what_its_signature_says(monkeypatch):
    """Moved, corrected by all sensors, its window gone on: by 2 % of it. It goes on from one instant of the grid to
    another; nothing is gated or granted.
    """
    monkeypatch.setattr(AdaptiveProcessNoise, "detect_onset", lambda *_: None)
    monkeypatch.setattr(AdaptiveProcessNoise, "required_level", lambda *_: NoiseLevel.NONE)
    config = msgspec.structs.replace(CONFIG, gate_probability=1.0, kept_m=0.0, deepest_m=100.0)
    of = dive(PAPER, 43, duration_s=40.0)

    def belief_of(messages):
        return Run(messages, PAPER, config).estimator.filter.propagated_belief()

    def instant(t_s):
        """Return the value at the first ping of the grid's step that begins then."""
        return next(m.t_ns for m in of.messages if isinstance(m, AdcpPing) and m.t_ns >= t_s * S)

    began_ns, ended_ns, nu = instant(18.0), instant(30.0), 5e-3
    without = belief_of(of.messages)
    from_s, until_s = began_ns * 1e-9, ended_ns * 1e-9
    with_drift = belief_of(with_water(of, lambda t_s, z: nu * np.clip(t_s - from_s, 0.0, until_s - from_s) + 0.0 * z))
    assert without.column.first > 0  # its window has gone on
    a, b = (2 * (t_ns // STEP_NS % STEPS) for t_ns in (began_ns, ended_ns))
    D = np.zeros((2 * STEPS, 2))
    D[[a, a + 1], [0, 1]], D[[b, b + 1], [0, 1]] = 1.0, -1.0
    signature = without.signatures.error @ D @ np.full(2, nu)
    moved = with_drift.x[VELOCITY][:2] - without.x[VELOCITY][:2]
    assert (np.abs(moved) > 0.03).all()
    np.testing.assert_allclose(moved, -signature[VELOCITY][:2], rtol=0.02)
    heard = D.T @ (with_drift.signatures.score - without.signatures.score)
    np.testing.assert_allclose(heard, D.T @ without.signatures.information @ D @ np.full(2, nu), rtol=0.05)
