"""Sources of the estimates in the controller: restarted, second and disagreeing publishers."""

from __future__ import annotations

import msgspec

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Estimate, Health, Plan
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle
from tests.stepping import step

MS = 1_000_000
CYCLE_MS, PERIOD_MS = 300, 100
TRUE, OTHER = 1, 2


class Publishing:
    """Controller whose estimates come from one or more publishers every 0.1 s."""

    def __init__(self) -> None:
        self.node = ControllerNode(Vehicle.load("paper"), Point(north_m=0.0, east_m=0.0), ControllerConfig())
        self.t_ms = 0

    def run(self, cycles: int, **north_m: float) -> list[Plan]:
        """Run cycles with estimates of the sources ``true`` and ``other`` at these places."""
        plans = []
        for _ in range(cycles):
            inbox = []
            for t_ms in range(self.t_ms, self.t_ms + CYCLE_MS, PERIOD_MS):
                for name, north in north_m.items():
                    estimate = msgspec.structs.replace(
                        Estimate.at_rest(north_m=north, depth_m=0.0), t_ns=t_ms * MS, covariance=None
                    )
                    epoch = TRUE if name == "true" else OTHER
                    inbox.append(ReceivedMessage(estimate, epoch, t_ms // PERIOD_MS, t_ms * MS))
            self.t_ms += CYCLE_MS
            outputs = step(self.node, self.t_ms * MS, inbox)
            plans += [message for message in outputs if isinstance(message, Plan)]
        return plans

    @property
    def active(self) -> int | None:
        return self.node.sources.selector.active


def test_a_second_source_changes_no_command_and_degrades_the_health_with_the_reason() -> None:
    alone, beset = Publishing(), Publishing()
    for each in (alone, beset):
        each.run(4, true=0.0)
    quiet, besieged = alone.run(30, true=0.0), beset.run(30, true=0.0, other=0.5)
    assert [plan.thrust_N.tolist() for plan in quiet] == [plan.thrust_N.tolist() for plan in besieged]
    assert {plan.health for plan in quiet} == {Health.NOMINAL}
    assert besieged[-1].health is Health.DEGRADED
    t_ns = beset.t_ms * MS
    assert f"second source on estimate: 90 messages rejected, the last of epoch {OTHER}" in beset.node.health_why(t_ns)
    assert beset.active == TRUE
    assert beset.run(7, true=0.0)[-1].health is Health.NOMINAL
    assert beset.node.health_why(beset.t_ms * MS) == ""


def test_a_restarted_publisher_is_used_again_within_a_second_and_the_former_one_after_it() -> None:
    publishing = Publishing()
    publishing.run(10, true=0.0)
    publishing.run(4, other=0.0)
    assert publishing.active == OTHER
    assert publishing.run(1, other=0.0)[-1].health is Health.NOMINAL
    publishing.run(4, true=0.0)
    assert publishing.active == TRUE


def test_a_source_elsewhere_takes_over_only_after_ten_seconds_without_a_believed_estimate() -> None:
    publishing = Publishing()
    publishing.run(10, true=0.0)
    publishing.run(30, other=60.0)
    assert publishing.active == TRUE
    assert publishing.run(10, other=60.0)[-1].estimate_t_ns == (publishing.t_ms - PERIOD_MS) * MS
    assert publishing.active == OTHER


def test_a_publisher_that_only_sends_implausible_estimates_is_replaced() -> None:
    publishing = Publishing()
    publishing.run(10, true=0.0)
    publishing.run(6, true=float("nan"), other=0.0)
    assert publishing.active == OTHER
