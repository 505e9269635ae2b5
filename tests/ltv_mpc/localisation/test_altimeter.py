"""Altitude from slant ranges: of a tilted vehicle with a lever arm, with a false echo, and only while it is seen."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.altimeter import MAX_AGE_NS, Altimeter
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import BottomTrack

BASE = SensorConfig.load("realistic")
REALISTIC = msgspec.structs.replace(BASE, adcp=msgspec.structs.replace(BASE.adcp, lever_arm_m=(0.6, -0.2, 0.3)))
DEPTH_M, BOTTOM_M = 10.0, 25.0


def tilted(t_ns: int = 0) -> Belief:
    belief = Belief.blank(Layout.of(REALISTIC, EstimatorConfig()), t_ns)
    belief.x[2] = DEPTH_M
    belief.R[:] = rotation(0.1, -0.2, 2.0)
    return belief


def ping(belief: Belief, t_ns: int = 0) -> BottomTrack:
    """Return the exact slant ranges to a level bottom."""
    down = (beam_directions(REALISTIC.adcp.beam_angle_rad) @ belief.mounting.T @ belief.R.T)[:, 2]
    transducer_m = DEPTH_M + (belief.R @ np.array(REALISTIC.adcp.lever_arm_m))[2]
    return BottomTrack(t_ns=t_ns, range_m=(BOTTOM_M - transducer_m) / down, beam_velocity_mps=np.zeros(4))


def test_the_altitude_is_that_of_the_vehicle_not_of_the_beams() -> None:
    altimeter = Altimeter(REALISTIC)
    assert altimeter.altitude_m(tilted()) is None
    altimeter.receive(ping(tilted()), tilted())
    assert altimeter.altitude_m(tilted()) == pytest.approx(BOTTOM_M - DEPTH_M)


def test_one_false_echo_of_four_hardly_moves_it_and_lost_beams_are_left_out() -> None:
    altimeter, belief = Altimeter(REALISTIC), tilted()
    wild = ping(belief)
    wild.range_m[1] = 2.0
    altimeter.receive(wild, belief)
    assert altimeter.altitude_m(belief) == pytest.approx(BOTTOM_M - DEPTH_M)
    wild.range_m[1:3] = np.nan
    altimeter.receive(wild, belief)
    assert altimeter.altitude_m(belief) == pytest.approx(BOTTOM_M - DEPTH_M)


def test_it_is_kept_for_a_while_and_one_beam_does_not_renew_it() -> None:
    altimeter, belief = Altimeter(REALISTIC), tilted()
    altimeter.receive(ping(belief), belief)
    lost = ping(belief, MAX_AGE_NS)
    lost.range_m[1:] = np.nan
    altimeter.receive(lost, belief)
    assert altimeter.altitude_m(tilted(MAX_AGE_NS)) == pytest.approx(BOTTOM_M - DEPTH_M)
    assert altimeter.altitude_m(tilted(MAX_AGE_NS + 1)) is None
