"""Altitude from slant ranges: of a tilted vehicle with a lever arm, with a false echo, and only while it is seen."""

import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.estimator import MAX_AGE_NS, Altimeter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import BottomTrack
from tests.ltv_mpc.localisation.dives import CONFIG, REALISTIC
from tests.ltv_mpc.localisation.sensors.every_sensor import with_settings

SENSORS = with_settings(REALISTIC, adcp={"lever_arm_m": (0.6, -0.2, 0.3)})
DEPTH_M, BOTTOM_M = 10.0, 25.0


def tilted(t_ns=0):
    belief = Belief.blank(Layout.of(SENSORS, CONFIG), t_ns)
    belief.x[2], belief.R[:] = DEPTH_M, rotation(0.1, -0.2, 2.0)
    return belief


def ping(t_ns=0, **ranges_m):
    """Return the exact slant ranges to a level bottom, some replaced: ``b1=2.0``."""
    belief = tilted()
    down = (beam_directions(SENSORS.adcp.beam_angle_rad) @ belief.R.T)[:, 2]
    slant = (BOTTOM_M - DEPTH_M - (belief.R @ np.array(SENSORS.adcp.lever_arm_m))[2]) / down
    for beam, range_m in ranges_m.items():
        slant[int(beam[1:])] = range_m
    return BottomTrack(t_ns=t_ns, range_m=slant, beam_velocity_mps=np.zeros(4))


@pytest.mark.parametrize("ranges_m", [{}, {"b1": 2.0}, {"b1": np.nan, "b2": np.nan}], ids=["all", "false echo", "two"])
def test_the_altitude_is_that_of_the_vehicle_for_a_while(ranges_m):
    altimeter = Altimeter(SENSORS)
    assert altimeter.altitude_m(tilted()) is None
    altimeter.receive(ping(**ranges_m), tilted())
    altimeter.receive(ping(MAX_AGE_NS, b1=np.nan, b2=np.nan, b3=np.nan), tilted())  # one beam does not renew it
    assert altimeter.altitude_m(tilted(MAX_AGE_NS)) == pytest.approx(BOTTOM_M - DEPTH_M)
    assert altimeter.altitude_m(tilted(MAX_AGE_NS + 1)) is None
