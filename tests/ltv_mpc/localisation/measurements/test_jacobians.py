"""Every partial derivative against central differences of its residual, over random beliefs of the fullest layout."""

import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.measurements import compass, gnss, pressure, tdcp
from ltv_mpc.localisation.measurements.adcp import AdcpModel
from ltv_mpc.localisation.state import ATTITUDE, Belief, Layout
from ltv_mpc.localisation.suite import Suite
from ltv_mpc.signals import AdcpPing, CompassHeading, GnssFix, PressureDepth, TdcpFix

SUITE = Suite.load("realistic")
CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SUITE, CONFIG)
ADCP = AdcpModel(SUITE.adcp, LAYOUT, CONFIG.cell_m)


def random_belief(rng):
    belief = Belief.blank(LAYOUT, 0)
    belief.x = rng.standard_normal(LAYOUT.size)
    belief.x[ATTITUDE] = 0
    belief.x[LAYOUT.mounting] = 0
    belief.x[2] = 20.3
    belief.R = rotation(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3))
    belief.mounting = rotation(*rng.uniform(-0.1, 0.1, 3))
    return belief


def ping(rng):
    return AdcpPing(t_ns=0, range_m=1.4 + np.arange(15.0), beam_velocity_mps=rng.standard_normal((4, 15)))


LINEARISED = {
    "gnss": lambda belief, _: gnss.rows(
        belief,
        GnssFix(t_ns=0, north_m=1.0, east_m=2.0, velocity_north_mps=3.0, velocity_east_mps=4.0),
        SUITE.gnss,
    ),
    "tdcp": lambda belief, _: tdcp.rows(belief, TdcpFix(t_ns=0, from_t_ns=0, north_m=1.0, east_m=2.0), SUITE.tdcp),
    "pressure": lambda belief, _: pressure.rows(belief, PressureDepth(t_ns=0, depth_m=1.0), SUITE.pressure),
    "compass": lambda belief, _: compass.rows(belief, CompassHeading(t_ns=0, heading_rad=0.3), SUITE.compass),
    "adcp": lambda belief, seen: ADCP.linearise(belief, seen, (0.3, -0.2, 0.1)).rows,
}


@pytest.mark.parametrize("sensor", LINEARISED)
@pytest.mark.parametrize("seed", range(3))
def test_partials_are_minus_the_derivatives_of_the_residual(sensor, seed):
    """1e-6 relative to the largest of a row; a residual is z - h, so its derivative is -H."""
    rng = np.random.default_rng(seed)
    belief, seen = random_belief(rng), ping(rng)
    H = LINEARISED[sensor](belief, seen).dense(LAYOUT.size)
    h = 1e-5
    difference = np.empty_like(H)
    for k in range(LAYOUT.size):
        error = np.zeros(LAYOUT.size)
        error[k] = h
        up, down = belief.copy(), belief.copy()
        up.add(error)
        down.add(-error)
        difference[:, k] = (LINEARISED[sensor](down, seen).residual - LINEARISED[sensor](up, seen).residual) / (2 * h)
    scale = np.abs(difference).max(axis=1, keepdims=True)
    np.testing.assert_allclose(H / scale, difference / scale, atol=1e-6)
