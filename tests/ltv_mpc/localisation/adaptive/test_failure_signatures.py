"""Failure signatures against a filter that receives the failure; filter/test_update.py has their gain."""

import numpy as np

from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.filter.state import Belief, Layout
from tests.ltv_mpc.localisation.dives import CONFIG, PAPER

LAYOUT = Layout.of(PAPER, CONFIG)


def test_the_antennas_clone_is_wrong_by_what_position_and_attitude_are():
    """P = E E^T holds before and after the clone."""
    belief = Belief.blank(LAYOUT, 0)
    belief.signatures = FailureSignatures.of(LAYOUT.size, 6)
    belief.signatures.error[:] = 0.1 * np.random.default_rng(0).standard_normal((LAYOUT.size, 6))
    belief.P = belief.signatures.error @ belief.signatures.error.T
    belief.clone_position((0.3, -0.2, 0.5))
    np.testing.assert_allclose(belief.P, belief.signatures.error @ belief.signatures.error.T, atol=1e-14)
