"""Slips of an installation: each is found by the motion, and none in a right installation."""

from __future__ import annotations

import math
from functools import cache

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Estimate
from ltv_mpc.safety.installation_slips import SLIPS, SlipTest
from ltv_mpc.safety.motion_fit import MotionFit
from tests.ltv_mpc.safety.test_motion_fit import STEP_S, VEHICLE, ns, steered

ESTIMATES = {
    "the heading is counted from east, to the left": lambda e: {"heading_rad": math.pi / 2 - e.heading_rad},
    "the heading is counted to the left": lambda e: {"heading_rad": -e.heading_rad},
    "the heading is in degrees": lambda e: {"heading_rad": math.degrees(e.heading_rad)},
    "the heading is that of the stern": lambda e: {"heading_rad": e.heading_rad + math.pi},
    "the heading is that of the port side": lambda e: {"heading_rad": e.heading_rad - math.pi / 2},
    "the heading is that of the starboard side": lambda e: {"heading_rad": e.heading_rad + math.pi / 2},
    "north and east are swapped": lambda e: {
        "north_m": e.east_m,
        "east_m": e.north_m,
        "velocity_north_mps": e.velocity_east_mps,
        "velocity_east_mps": e.velocity_north_mps,
    },
}
THRUSTS = {
    "port and starboard thruster are swapped": lambda port, starboard: (starboard, port),
    "the port thruster is reversed": lambda port, starboard: (-port, starboard),
    "the starboard thruster is reversed": lambda port, starboard: (port, -starboard),
    "both thrusters are reversed": lambda port, starboard: (-port, -starboard),
}


@cache
def sailed(seconds: float, **true: float) -> list[tuple[Estimate, tuple[float, float]]]:
    """Return the right estimates of a flight each 0.3 s, and the thrusts of port and starboard."""
    t, states, thrust = steered(seconds, **true)
    positions = STEP_S * np.cumsum(states[:, :2], axis=0)
    return [
        (
            msgspec.structs.replace(
                Estimate.at_rest(),
                t_ns=ns(t[k]),
                north_m=positions[k, 0],
                east_m=positions[k, 1],
                velocity_north_mps=states[k, 0],
                velocity_east_mps=states[k, 1],
                heading_rad=math.remainder(states[k, 2], math.tau),
                yaw_rate_radps=states[k, 3],
            ),
            (float(thrust[k, 0]), float(thrust[k, 1])),
        )
        for k in range(0, len(t), 30)
    ]


def found(slip: str = "", seconds: float = 60.0, noise_m: float = 0.0, noise_mps: float = 0.0, **true: float) -> str:
    """Return what is found after a flight with one slip."""
    fit, rng = MotionFit(VEHICLE), np.random.default_rng(5)
    test = SlipTest(fit)
    for right, delivered_N in sailed(seconds, **true):
        commanded_N = THRUSTS[slip](*delivered_N) if slip in THRUSTS else delivered_N
        north_m, east_m, north_mps, east_mps = rng.standard_normal(4) * (noise_m, noise_m, noise_mps, noise_mps)
        given = msgspec.structs.replace(right, **ESTIMATES[slip](right)) if slip in ESTIMATES else right
        given = msgspec.structs.replace(
            given,
            north_m=given.north_m + north_m,
            east_m=given.east_m + east_m,
            velocity_north_mps=given.velocity_north_mps + north_mps,
            velocity_east_mps=given.velocity_east_mps + east_mps,
        )
        fit.add_thrust(given.t_ns, (*commanded_N, 0.0), reported=False)
        if fit.update(given):
            test.update()
    return test.found


@pytest.mark.parametrize("slip", SLIPS)
def test_each_slip_is_found_also_with_a_wrong_file(slip):
    assert found(slip, mass=1.5, drag=0.7) == slip


@pytest.mark.parametrize("noise", [{}, {"noise_m": 0.3}, {"noise_mps": 0.1}])
@pytest.mark.parametrize("true", [{}, {"mass": 2.0, "drag": 0.5}, {"port": 0.3}, {"wind_mps2": 0.1}])
def test_in_a_right_installation_none_is_found(true, noise):
    assert found(**noise, **true) == ""
