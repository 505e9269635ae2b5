"""Flights of a controller, or of its node, with the nominal model of its vehicle."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import msgspec
import numpy as np

from ltv_mpc import Controller, Estimate, Plan, Vehicle, advance
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.messages import Acknowledgement, Action, Array, Command, ControllerState, CurrentProfile, Message
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point, Reference
from ltv_mpc.validation import rejection_reason
from ltv_mpc.vehicle.parameters import Thruster
from tests.ltv_mpc.estimates import moving, water
from tests.ltv_mpc.reports import report

PAPER = Vehicle.load("paper")
S = 1_000_000_000
PERIOD_NS = 300_000_000
START = Estimate.at_rest(north_m=0.3, heading_rad=0.4, depth_m=2.0)
ARM = Command(command_id=1, action=Action.ARM)


def at_rest(north_mps: float = 0.0, east_mps: float = 0.0, **place: float) -> Estimate:
    """Return a vehicle at rest over ground, in a current that it knows."""
    return msgspec.structs.replace(Estimate.at_rest(**place), current=water(north_mps, east_mps))


def drifting(north_mps: float = 0.0, east_mps: float = 0.0) -> Estimate:
    """Return a vehicle at rest in the water of a current that it knows."""
    return moving((north_mps, east_mps), current=water(north_mps, east_mps))


Change: TypeAlias = Callable[[Estimate], Estimate]


def fly(
    controller: Controller,
    estimate: Estimate,
    cycles: int,
    *,
    true: Vehicle | None = None,
    seen: Change = lambda estimate: estimate,
    moved: Change = lambda estimate: estimate,
    solved: bool = True,
) -> tuple[list[Estimate], list[Plan]]:
    """Follow the plans for so many cycles of 0.3 s; return the estimates after them, and the plans.

    The controller gets the estimates as ``seen``. The vehicle moves as ``true``, or its own one, and then to where
    ``moved`` lets it. All plans have to be solved, if the controller has lateral plans, unless ``solved`` is False.
    """
    way, plans = [], []
    for _ in range(cycles):
        plans.append(controller.plan(seen(estimate)))
        assert plans[-1].origin == "solved" or not (controller.config.lateral and solved), plans[-1].why
        estimate = moved(advance(true or controller.vehicle, estimate, plans[-1], duration_s=0.3))
        way.append(estimate)
    return way, plans


def rough_current(seed: int) -> CurrentProfile:
    """Return a rough current of 4 cm/s: cosines of random phase."""
    rng = np.random.default_rng(seed)
    z = np.arange(71.0)
    north, east = (
        sum(0.028 * np.cos(z / length + rng.uniform(0, 2 * np.pi)) for length in (4.0, 9.0)) for _ in range(2)
    )
    return CurrentProfile(depth_m=z, north_mps=np.array(north), east_mps=np.array(east))


def descend(
    seed: int, cycles: int, config: ControllerConfig | None = None, **start: float
) -> tuple[list[Estimate], list[Plan]]:
    """Simulate a descent of the nominal model with reports, from rest at ``start``; plans may begin late."""
    controller = Controller(PAPER, Point(north_m=0.0, east_m=0.0, depth_m=60.0), config)
    estimate = Estimate.at_rest(depth_m=0.0, **start)
    estimate = msgspec.structs.replace(estimate, current=rough_current(seed))
    estimates, plans = [estimate], []
    vehicle = Prediction(PAPER)
    for _ in range(cycles):
        plan = controller.plan(estimate)
        vehicle.sent.add(plan)
        end = vehicle.state_at(estimate, estimate.t_ns + 300_000_000)
        delivered = report(end.t_ns, [*end.X[6:], end.vertical_N], end.command)
        vehicle.add_report(delivered)
        controller.add_report(delivered)
        estimate = as_estimate(end, estimate)
        plans.append(plan)
        estimates.append(estimate)
    return estimates, plans


def column(way: list[Estimate], name: str) -> Array:
    """Return a field of all estimates."""
    return np.array([getattr(estimate, name) for estimate in way])


def track(way: list[Estimate]) -> Array:
    """Return the positions (K, 2) north and east (m)."""
    return np.array([(estimate.north_m, estimate.east_m) for estimate in way])


def assert_within_box_and_slew(plans: list[Plan], vertical: Thruster) -> None:
    """Assert that no plan leaves the limits of the vertical thruster."""
    for plan in plans:
        F = plan.thrust_N[:, 2]
        assert vertical.min_N - 1e-9 <= F.min()
        assert F.max() <= vertical.max_N + 1e-9
        assert np.all(np.abs(np.diff(F)) <= vertical.slew_N_per_s * np.diff(plan.t_ns) * 1e-9 + 1e-9)


class Flight:
    """Controller node in a closed loop with the nominal model, without delay."""

    def __init__(
        self, reference: Reference | None, *, node: ControllerNode | None = None, estimate: Estimate | None = START
    ) -> None:
        self.node = node or ControllerNode(PAPER, reference, ControllerConfig())
        self.reference = reference
        self.estimate = estimate
        self.plans: list[Plan] = []
        self.states: list[ControllerState] = []
        self.answers: list[Acknowledgement] = []
        self.messages: list[Message] = []  # all
        self._sequence = 0

    def arrival(self, signal: Message, t_ns: int) -> ReceivedMessage:
        self._sequence += 1
        return ReceivedMessage(signal, 1, self._sequence, t_ns)

    def run(self, t_ns: int, *messages: Message) -> Plan | None:
        """Run one cycle with these messages alone."""
        plan = None
        for signal in self.node.step(t_ns, [self.arrival(message, t_ns) for message in messages]):
            assert rejection_reason(signal) is None
            self.messages.append(signal)
            match signal:
                case Plan():
                    plan = signal
                    self.plans.append(signal)
                case ControllerState():
                    self.states.append(signal)
                case Acknowledgement():
                    self.answers.append(signal)
        return plan

    def step(self, *messages: Message) -> Plan:
        """Run one cycle with the estimate of now, and move the vehicle by it."""
        self.run(self.estimate.t_ns, *messages, self.estimate)
        self.estimate = advance(PAPER, self.estimate, self.plans[-1], duration_s=0.3)
        return self.plans[-1]

    def fly(self, cycles: int) -> Plan:
        for _ in range(cycles):
            plan = self.step()
        return plan

    def handed_over(self, silent_s: float, reference: Reference | None = None) -> tuple[Flight, ControllerState]:
        """Replace the node ``silent_s`` after its last plan, which the vehicle has followed since."""
        last = self.plans[-1]
        estimate = self.estimate
        if silent_s > 0:
            estimate = advance(PAPER, estimate, last, duration_s=silent_s)
        state = msgspec.structs.replace(self.states[-1], plan=last, estimate=self.estimate)
        node = ControllerNode(PAPER, reference or self.reference, ControllerConfig())
        return Flight(None, node=node, estimate=estimate), state


def armed(reference: Reference, cycles: int) -> Flight:
    flight = Flight(reference)
    flight.step(ARM)
    flight.fly(cycles)
    return flight
