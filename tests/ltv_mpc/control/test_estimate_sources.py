"""Sources of the estimates in the controller: restarted, second, named and disagreeing publishers."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Acknowledgement, Action, Command, ControllerState, Estimate, Health, Message, Plan
from ltv_mpc.node import DEFAULT_SOURCE, ReceivedMessage
from ltv_mpc.references import Point
from ltv_mpc.safety.source_selector import Source
from ltv_mpc.vehicle.parameters import Vehicle

MS = 1_000_000
CYCLE_MS, PERIOD_MS = 300, 100
TRUE, OTHER = 1, 2


class From(NamedTuple):
    """Publisher at rest that sends an estimate every 0.1 s."""

    epoch: int = TRUE
    north_m: float = 0.0
    name: str = DEFAULT_SOURCE
    late_ms: int = 0
    covariance: np.ndarray | None = None

    def estimate(self, t_ms: int) -> Estimate:
        at_rest = Estimate.at_rest(north_m=self.north_m, depth_m=0.0)
        return msgspec.structs.replace(at_rest, t_ns=(t_ms - self.late_ms) * MS, covariance=self.covariance)


class Controlled:
    """Controller whose estimates come from one or more publishers."""

    def __init__(self, *order: str) -> None:
        config = ControllerConfig(sources=order or (DEFAULT_SOURCE,))
        self.node = ControllerNode(Vehicle.load("paper"), Point(north_m=0.0, east_m=0.0), config)
        self.t_ms = 0
        self.outputs: list[Message] = []

    def run(self, cycles: int, *sources: From, command: Command | None = None) -> list[Plan]:
        """Run cycles with estimates of these sources, and return their plans."""
        self.outputs = []
        for _ in range(cycles):
            inbox = [] if command is None else [ReceivedMessage(command, 9, self.t_ms, self.t_ms * MS)]
            command = None
            for t_ms in range(self.t_ms, self.t_ms + CYCLE_MS, PERIOD_MS):
                inbox += [
                    ReceivedMessage(source.estimate(t_ms), source.epoch, t_ms // PERIOD_MS, t_ms * MS, source.name)
                    for source in sources
                ]
            self.t_ms += CYCLE_MS
            self.outputs += self.node.step(self.t_ms * MS, inbox)
        return [message for message in self.outputs if isinstance(message, Plan)]

    def after(self, cycles: int, *sources: From) -> Controlled:
        self.run(cycles, *sources)
        return self

    def choose(self, name: str, *sources: From) -> Acknowledgement:
        self.run(1, *sources, command=Command(command_id=1, action=Action.SOURCE, source=name))
        (reply,) = (message for message in self.outputs if isinstance(message, Acknowledgement))
        return reply

    @property
    def saved(self) -> ControllerState:
        """State published last, within the last run."""
        return [message for message in self.outputs if isinstance(message, ControllerState)][-1]

    @property
    def active(self) -> int | None:
        source = self.node.active_source
        return None if source is None else source.epoch


@pytest.mark.parametrize("late_ms", [500, 1000])
def test_a_publisher_that_restarts_with_late_stamps_is_used_within_1_5_s(late_ms: int) -> None:
    controlled = Controlled().after(10, From())
    controlled.run(5, From(OTHER, late_ms=late_ms))
    assert controlled.active == OTHER


def test_a_source_elsewhere_takes_over_only_after_ten_seconds_of_silence() -> None:
    controlled = Controlled().after(10, From())
    controlled.run(30, From(OTHER, north_m=60.0))
    assert controlled.active == TRUE
    assert controlled.run(10, From(OTHER, north_m=60.0))[-1].estimate_t_ns == (controlled.t_ms - PERIOD_MS) * MS
    assert controlled.active == OTHER


@pytest.mark.parametrize(
    ("off_m", "sd_m", "agrees"), [(2.0, None, True), (4.0, None, False), (1.5, 0.1, False), (4.0, 2.0, True)]
)
def test_a_candidate_agrees_within_the_deviations_told_or_half_a_metre_each(
    off_m: float, sd_m: float | None, agrees: bool
) -> None:
    covariance = None if sd_m is None else np.diag([sd_m**2, sd_m**2, 1e-4, 1e-4, 1e-4, 1e-6])
    controlled = Controlled().after(10, From(covariance=covariance))
    controlled.run(4, From(OTHER, north_m=off_m, covariance=covariance))
    assert controlled.active == (OTHER if agrees else TRUE)


def test_a_publisher_that_only_sends_implausible_estimates_is_replaced() -> None:
    controlled = Controlled().after(10, From())
    controlled.run(6, From(north_m=float("nan")), From(OTHER))
    assert controlled.active == OTHER


def test_a_publisher_that_repeats_one_estimate_is_replaced() -> None:
    controlled = Controlled().after(10, From())
    frozen = From().estimate(controlled.t_ms - PERIOD_MS)
    for k in range(5):
        controlled.node.receive(ReceivedMessage(frozen, TRUE, 1000 + k, controlled.t_ms * MS))
        controlled.run(1, From(OTHER))
    assert controlled.active == OTHER


def test_old_estimates_of_the_active_source_do_not_delay_the_health() -> None:
    controlled = Controlled().after(10, From())
    old = From().estimate(controlled.t_ms - PERIOD_MS)
    for k in range(2):
        controlled.node.receive(ReceivedMessage(old, TRUE, 1000 + k, controlled.t_ms * MS))
        plans = controlled.run(1)
    assert plans[-1].health is Health.DEGRADED  # 0.7 s old, at ten estimates a second


def test_named_sources_by_order_and_back_after_five_seconds_of_agreement() -> None:
    plain, gnss = From(), From(OTHER, north_m=0.3, name="gnss")
    controlled = Controlled("gnss", "default")
    plans = controlled.run(10, plain, gnss)
    assert controlled.node.active_source == Source("default", TRUE)  # the first that was believed
    assert {plan.health for plan in plans} == {Health.NOMINAL}
    controlled.run(10, plain, gnss)
    assert controlled.node.active_source == Source("gnss", OTHER)
    controlled.run(4, plain)
    assert controlled.active == TRUE
    controlled.run(15, plain, gnss)
    assert controlled.active == TRUE
    controlled.run(4, plain, gnss)
    assert controlled.active == OTHER


def test_an_operator_chooses_a_source_and_the_choice_is_saved_and_restored() -> None:
    plain, dvl = From(), From(OTHER, north_m=40.0, name="dvl")
    controlled = Controlled().after(10, plain, dvl)
    rejected = controlled.choose("gnss", plain, dvl)
    assert not rejected.accepted
    assert rejected.why == "no valid message of source gnss in the last 10 s; sources: default, dvl"
    assert controlled.choose("dvl", plain, dvl).accepted
    saved = controlled.saved
    assert saved.source == "dvl"
    assert controlled.run(1, plain, dvl)[-1].estimate_t_ns == (controlled.t_ms - PERIOD_MS) * MS
    assert controlled.active == OTHER
    after = Controlled()
    after.node.step(0, [ReceivedMessage(saved, 3, 0, 0)])
    after.run(4, plain, dvl)
    assert after.active == OTHER


def test_without_a_name_the_order_of_the_settings_counts_again() -> None:
    plain, dvl = From(), From(OTHER, north_m=0.3, name="dvl")
    controlled = Controlled().after(10, plain, dvl)
    controlled.choose("dvl", plain, dvl)
    controlled.run(1, plain, dvl)
    assert controlled.active == OTHER
    assert controlled.choose("", plain, dvl).accepted
    assert controlled.saved.source == ""
    controlled.run(20, plain, dvl)
    assert controlled.active == TRUE  # preferred, after five seconds of agreement
