"""Lateral plans with a weak thruster: the model, the box and the commands."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, Estimate, Plan, PlanOrigin, Vehicle, advance, references
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.resolution import settled
from ltv_mpc.messages import Authority, ControllerState, Health
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.safety.command_arbiter import ThrustOverride
from tests.ltv_mpc.control.problems import SOLVER_NAMES
from tests.ltv_mpc.estimates import moving, water

PAPER = Vehicle.load("paper")
START = Estimate.at_rest(north_m=-1.0, heading_rad=0.3, depth_m=2.0)
FAR = msgspec.structs.replace(START, north_m=-30.0)
WEAK = 0.4, 1.0


def controller(shares: tuple[float, float], **settings: object) -> Controller:
    """Return a controller that holds the origin with thrusters of these shares."""
    made = Controller(PAPER, references.Hold(depth_m=2.0), ControllerConfig(**settings))
    made.plan(Estimate.at_rest(depth_m=2.0))  # the reference begins at the origin
    made.set_thrust_shares(shares)
    return made


def of_the_water(plan: Plan, shares: tuple[float, float]) -> Plan:
    """Return the plan as the water feels it."""
    return msgspec.structs.replace(plan, thrust_N=plan.thrust_N * [*shares, 1.0])


@pytest.mark.parametrize("shares", [WEAK, (1.0, 0.2), (1.0, 1.0)])
def test_the_predicted_motion_is_that_of_the_thrust_that_is_delivered(shares):
    start = msgspec.structs.replace(START, t_ns=300_000_000)
    plan = controller(shares, horizon_s=4.8).plan(start)  # it is followed to its end
    assert plan.origin is PlanOrigin.SOLVED
    first = int(plan.t_ns[0])
    at_first = msgspec.structs.replace(start, t_ns=first)
    end = advance(PAPER, at_first, of_the_water(plan, shares), duration_s=(int(plan.t_ns[-1]) - first) * 1e-9)
    np.testing.assert_allclose(plan.states[-1, :2], (end.north_m, end.east_m), atol=2e-3)


@pytest.mark.parametrize("solver", SOLVER_NAMES)
def test_the_plan_is_that_of_a_vehicle_with_thrusters_of_that_strength(solver):
    """The problem is the same, so are its steps in newtons of the water; from 30 m away the box bounds them."""
    config = msgspec.structs.replace(settled(ControllerConfig(horizon_s=5.1), PAPER), solver=solver, sqp_iterations=1)
    tables = msgspec.to_builtins(PAPER)
    for name in ("min_N", "max_N", "slew_N_per_s"):
        tables["thruster"]["port"][name] *= 0.5
    weak, small = Controller(PAPER, ORIGIN, config), Controller(msgspec.convert(tables, Vehicle), ORIGIN, config)
    weak.set_thrust_shares((0.5, 1.0))
    for start in (START, FAR):
        commands, delivered = (of.plan(start).thrust_N for of in (weak, small))
        np.testing.assert_allclose(commands * [0.5, 1.0, 1.0], delivered, atol=1e-3)
    assert commands[:, 0].max() > 60.0  # its whole command


def test_thrusters_that_are_sound_again_give_the_plans_of_before():
    """Bit for bit, except that the solver begins without its warm start."""
    near = msgspec.structs.replace(START, t_ns=300_000_000)
    sound, recovered = controller((1.0, 1.0)), controller(WEAK)
    recovered.set_thrust_shares((1.0, 1.0))
    np.testing.assert_array_equal(recovered.plan(near).thrust_N, sound.plan(near).thrust_N)


def test_an_override_is_commanded_as_it_is():
    override = ThrustOverride(Authority.MANUAL, (20.0, -20.0, 0.0), 10**12, "manual")
    plan = controller(WEAK).plan(msgspec.structs.replace(START, t_ns=300_000_000), override=override)
    np.testing.assert_allclose(plan.thrust_N[-1, :2], [20.0, -20.0], rtol=1e-15)


ORIGIN = references.Point(north_m=0.0, east_m=0.0, depth_m=2.0)
OFF = msgspec.structs.replace(START, current=water())


def test_a_node_plans_with_the_share_that_a_weak_thruster_delivers():
    state = ControllerState(t_ns=0, thrust_shares=(0.6, 1.0), authority=Authority.CONTROLLER)
    inbox = [ReceivedMessage(message, 1, k, 0) for k, message in enumerate((state, OFF))]
    outputs = ControllerNode(PAPER, ORIGIN, ControllerConfig()).step(0, inbox)
    (plan,) = [message for message in outputs if isinstance(message, Plan)]
    alone = Controller(PAPER, ORIGIN, ControllerConfig())
    alone.set_thrust_shares((0.6, 1.0))
    np.testing.assert_array_equal(plan.thrust_N, alone.plan(OFF, t_ns=0).thrust_N)
    assert np.abs(plan.thrust_N[:, :2]).max() > 10.0
    assert plan.health is Health.DEGRADED


@pytest.mark.parametrize(
    ("radius_m", "tolerance_m", "current_mps", "sinking_mps", "heading_deg"),
    [
        (0.07, 0.0, 0.0, 0.0, None),  # in still water,
        (0.07 / (1.0 + 1.5 * 2.0**2), 0.0, 0.03, 0.0, None),
        (0.0, 0.0, 0.0, 0.02, None),  # and none where a vehicle sinks, rises, or has a heading
        (0.0, 0.0, 0.0, 0.0, 0.0),
        (0.3, 0.3, 0.0, 0.0, None),  # the tolerance, if it is larger, and always
        (0.3, 0.3, 0.03, 0.02, 0.0),
    ],
)
def test_a_vehicle_rests_within_a_distance_of_its_point(radius_m, tolerance_m, current_mps, sinking_mps, heading_deg):
    """The plan is then that of a vehicle at the point; the bow is north, into the current."""

    def change_N(off_m: float) -> float:
        """Largest change of a plan when a vehicle that kept its point is suddenly off."""
        point = references.Point(north_m=0.0, east_m=0.0, heading_deg=heading_deg)
        controller = Controller(PAPER, point, ControllerConfig(position_tolerance_m=tolerance_m))
        at = moving(depth_m=5.0, velocity_down_mps=sinking_mps, current=water(-current_mps))
        plans = [controller.plan(msgspec.structs.replace(at, t_ns=k * 300_000_000)) for k in range(20)]
        assert all(plan.origin is PlanOrigin.SOLVED for plan in plans)  # also the first one
        after = controller.plan(msgspec.structs.replace(at, t_ns=6_000_000_000, north_m=off_m))
        return float(np.abs(after.thrust_N[:, :2] - plans[-1].thrust_N[:, :2]).max())

    assert change_N(0.95 * radius_m) < 0.1
    assert change_N(radius_m + 0.01) > 0.5
