"""The loop that a horizon closes: its poles are the controller's own, and the proposed horizon's are stable."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Vehicle, references
from ltv_mpc.control.config import ResolvedConfig, WeightSettings
from ltv_mpc.control.horizon_selection import MIN_TIME_SCALES
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.control.stability import is_stable, spectral_radius, steady_state
from tests.ltv_mpc.reports import report

SIDE = {
    "arm_m": 0.38,
    "min_N": -148.0,
    "max_N": 252.0,
    "slew_N_per_s": 275.0,
    "lag_s": 0.067,
    "propeller_diameter_m": 0.5,
    "max_rps": 30.0,
}
LIGHT = msgspec.convert(
    {
        "name": "light to the side",
        "description": "quick to turn, slow to stop drifting",
        "dry_mass_kg": 317.0,
        "water_density_kgpm3": 1025.0,
        "surge": {"mass_kg": 770.0, "linear_damping_kgps": 241.0, "quadratic_damping_kgpm": 394.0},
        "sway": {"mass_kg": 521.0, "linear_damping_kgps": 57.0, "quadratic_damping_kgpm": 607.0},
        "yaw": {"inertia_kgm2": 181.0, "linear_damping_Nms": 225.0, "quadratic_damping_kgm2": 193.0},
        "thruster": {"port": SIDE, "starboard": SIDE},
    },
    Vehicle,
)
SHARE = 0.35
CYCLE_NS = 300_000_000


def with_horizon(vehicle: Vehicle, horizon_s: float) -> ResolvedConfig:
    """Return settings with this horizon and the vehicle's own weights."""
    return settled(ControllerConfig(horizon_s=horizon_s), vehicle)


def aside(vehicle: Vehicle, horizon_s: float, cycles: int, off_m: float = 1e-4) -> np.ndarray:
    """Off its place to the side, bow-on in a current, after each cycle (m); at first ``off_m``."""
    X, C = steady_state(vehicle, SHARE)
    profile = CurrentProfile(depth_m=np.zeros(1), north_mps=C[:1], east_mps=C[1:])
    estimate = msgspec.structs.replace(Estimate.at_rest(east_m=off_m), current=profile)
    controller = Controller(vehicle, references.Point(north_m=0.0, east_m=0.0), ControllerConfig(horizon_s=horizon_s))
    commands, motion = SentCommands(vehicle), Prediction(vehicle)
    applied, off = report(0, [*X[6:], 0.0]), []
    for _ in range(cycles):
        controller.add_report(applied)
        motion.add_report(applied)
        commands.correct(applied.t_ns, applied.command_N)
        plan = controller.plan(estimate)
        assert plan.origin == "solved"
        commands.add(plan)
        end = motion.state_at(estimate, estimate.t_ns + CYCLE_NS, commands)
        applied = report(end.t_ns, [*end.X[6:], end.vertical_N], end.command)
        estimate = as_estimate(end, estimate)
        off.append(abs(estimate.east_m))
    return np.array(off)


def test_the_controllers_own_error_grows_as_the_largest_pole_says():
    """While it is so small that its plans are linear in it to their ends, and once the faster modes have died away."""
    off = aside(LIGHT, 5.1, 85, 1e-6)
    assert off[84] < 1e-5
    assert (off[84] / off[54]) ** (1 / 30) == pytest.approx(
        spectral_radius(LIGHT, with_horizon(LIGHT, 5.1), SHARE), rel=0.003
    )


def test_with_the_horizon_that_is_proposed_it_dies_away():
    proposed_s, short_s = (
        settled(ControllerConfig(), LIGHT).horizon_s,
        MIN_TIME_SCALES * characteristic_scales(LIGHT).time_s,
    )
    assert is_stable(LIGHT, with_horizon(LIGHT, proposed_s))
    assert not is_stable(LIGHT, with_horizon(LIGHT, proposed_s / 1.1))  # it is no longer than that takes
    off = aside(LIGHT, proposed_s, 120, 1e-3)
    assert off[119] < off[60] < 1e-3  # slowly: the hull hardly brakes a drift
    assert aside(LIGHT, short_s, 120, 1e-3)[90:].max() > 7e-3


def test_the_proposal_is_stable_with_the_weights_in_use():
    """A controller with less weight on thrust needs a longer horizon."""
    usual, eager = settled(ControllerConfig(), LIGHT), WeightSettings(thrust=1e-3)
    proposed = settled(ControllerConfig(weights=eager), LIGHT)
    assert proposed.horizon_s > usual.horizon_s
    assert is_stable(LIGHT, proposed)
    assert not is_stable(LIGHT, settled(ControllerConfig(weights=eager, horizon_s=usual.horizon_s), LIGHT))


@pytest.mark.parametrize("name", ["paper", "surface", "low-yaw", "weak-reverse"])
def test_of_the_shipped_vehicles_all_are_stable_with_theirs(name):
    """Without linear drag to the side a drift stays as it is: its pole is 1."""
    vehicle = Vehicle.load(name)
    assert is_stable(vehicle, settled(ControllerConfig(), vehicle))
