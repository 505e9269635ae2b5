"""Estimates that are stamped when they arrive: the stamps are named, and no thruster is blamed any more."""

from __future__ import annotations

from benchmarks.strangers.flight import Conditions, Ours, Start, fly, load
from benchmarks.strangers.tasks import SQUARE, reference
from ltv_mpc import ControllerConfig, Estimate
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Applied, Authority, ModelCheck, Plan
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point

LATE = "the estimates are older than their stamps by about 0."


class ThroughNode(Ours):
    """Pilot that is the node of the controller, with its check of the model."""

    def __init__(self, vehicle, path) -> None:
        self.node = ControllerNode(vehicle, path, ControllerConfig())
        self.node.arbiter.authority = Authority.CONTROLLER
        self.controller, self.nominal, self.said = self.node.controller, False, []

    def plan(self, estimate: Estimate, t_ns: int, applied: Applied | None):
        """Return the plan of one cycle."""
        inbox = [ReceivedMessage(m, 1, len(self.said), t_ns) for m in (estimate, applied) if m is not None]
        messages = self.node.step(t_ns, inbox)
        plan = next(message for message in messages if isinstance(message, Plan))
        checks = [message.why for message in messages if isinstance(message, ModelCheck)]
        self.said.append((t_ns * 1e-9, "; ".join([plan.health_why, *checks])))
        return plan.t_ns, plan.thrust_N[:, :2]


def said_of(speed_mps: float, conditions: Conditions, duration_s: float) -> list[tuple[float, str]]:
    """Return what the controller says of its health and of its vehicle along a square, by time (s)."""
    pilot = ThroughNode(load("light_boat")[1], reference(SQUARE, speed_mps))
    fly("light_boat", pilot, conditions, Start(current_rad=0.6), duration_s=duration_s)
    return pilot.said


def test_late_stamps_are_named_within_45_s_and_then_no_thruster_is_blamed():
    conditions = Conditions(latency_s=0.5, jitter_s=0.3, stamped_at_arrival=True, current_mps=0.2)
    said = said_of(0.8, conditions, 100.0)
    first_s = next(t for t, text in said if LATE in text)
    assert first_s < 45.0
    after = [text for t, text in said if t > first_s + 1.0]
    assert all(LATE in text for text in after)
    assert not any("lost share" in text or "weak" in text or "looks" in text for text in after)


def test_a_boat_whose_stamps_are_late_settles_once_they_are_named():
    """Its thrusters go from end to end until then; they never stopped, 1.1 m off on average."""
    pilot, conditions = (
        Ours(load("light_boat")[1], Point(north_m=4.0, east_m=3.0)),
        Conditions(latency_s=0.8, stamped_at_arrival=True, current_mps=0.25, reports_s=0.0),
    )
    flight = fly("light_boat", pilot, conditions, Start.drawn(1, 0.3), duration_s=100.0)
    assert flight.distance_m((4.0, 3.0), 60.0, 100.0).max() < 0.5
    assert flight.mean_N(60.0, 100.0) < 0.25 * load("light_boat")[0].max_N
    assert not flight.nominal[flight.between(60.0, 100.0)].any()


def test_estimates_that_arrive_late_with_the_right_stamps_are_not_named():
    conditions = Conditions(latency_s=0.5, jitter_s=0.3, current_mps=0.1)
    assert not any("stamps" in text for _, text in said_of(0.4, conditions, 90.0))
