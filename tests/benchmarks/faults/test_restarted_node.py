"""Restarted node: silence while it is dead, then a new node that begins with the state and the plan of the last one."""

from __future__ import annotations

import msgspec

from benchmarks.faults.effects import Interval, RestartedNode
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Action, Authority, Command, Estimate, Plan, PlanOrigin
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle

S = 1_000_000_000
POINT = Point(north_m=0.0, east_m=0.0)


def test_a_new_node_goes_on_armed_and_solves_its_second_plan() -> None:
    made: list[ControllerNode] = []

    def make() -> ControllerNode:
        made.append(ControllerNode(Vehicle.load("surface"), POINT, ControllerConfig()))
        return made[-1]

    node = RestartedNode(make, [Interval(2 * S, 4 * S)])
    plans: dict[int, list[Plan]] = {}
    for i in range(20):
        t_ns = i * 300_000_000
        estimate = msgspec.structs.replace(Estimate.at_rest(), t_ns=t_ns)
        inbox = [ReceivedMessage(estimate, 1, i, t_ns)]
        if i == 0:
            inbox.append(ReceivedMessage(Command(command_id=1, action=Action.ARM), 2, 0, t_ns))
        outputs = node.step(t_ns, inbox)
        plans[t_ns] = [message for message in outputs if isinstance(message, Plan)]
    assert len(made) == 2
    assert [t_ns for t_ns, of in plans.items() if not of] == [t for t in plans if 2 * S <= t < 4 * S]
    first, second = [of[0] for t_ns, of in plans.items() if t_ns >= 4 * S][:2]
    assert first.authority is second.authority is Authority.CONTROLLER
    assert second.origin is PlanOrigin.SOLVED
