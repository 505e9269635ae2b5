"""Controller status: its figures, the status line, the metrics for Prometheus."""

from __future__ import annotations

import contextlib
import http.client
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc import ControllerConfig, Fence, Vehicle, references
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import (
    Action,
    Authority,
    ClockMode,
    ClockStep,
    Command,
    ControllerStatus,
    Estimate,
    Health,
    Leak,
    Message,
    Plan,
)
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.safety.mission_policy import MissionSettings
from ltv_mpc.vehicle.reference_point import ReferencePoint
from services.bus.message_validation import MessageValidator
from services.runtime.clock_sync import ClockOffset
from services.runtime.controller_status import ControllerStatusReporter, status_line
from services.runtime.metrics import Metrics, serving
from tests.services.edges.plans import plan

STATUS = ControllerStatus(
    t_ns=5,
    estimate_age_ns=40_000_000,
    applied_age_ns=60_000_000,
    cycle_median_us=900.0,
    cycle_p99_us=2100.0,
    received=450,
    dropped=1,
    rejected={'depth "m"\n': 2, "out of order": 3},
    clock=ClockMode.TWO_WAY,
    clock_error_ns=900_000,
    authority=Authority.CONTROLLER,
    health=Health.NOMINAL,
    error_m=0.25,
)
SHARED = ClockOffset(ClockMode.SHARED, 0, 0)
S = 1_000_000


PLAN = msgspec.structs.replace(plan(0), reference_m=(0.0, 0.0))


@pytest.fixture
def node() -> ControllerNode:
    return ControllerNode(Vehicle.load("paper"), references.Point(north_m=0.0, east_m=0.0), ControllerConfig())


def test_its_figures_are_those_of_the_last_ten_seconds_and_of_the_newest_inputs(node: ControllerNode) -> None:
    shown: list[ControllerStatus] = []
    report = ControllerStatusReporter(node, [lambda status: shown.append(status)])
    first = report.status(0, 0, MessageValidator(), SHARED)
    assert (first.estimate_age_ns, first.cycle_median_us, first.error_m) == (None, None, None)
    assert (first.authority, first.health) == ("disarmed", "degraded")
    estimate = msgspec.structs.replace(Estimate.at_rest(north_m=3.0, east_m=4.0), t_ns=7_000_000_000)
    arm = Command(command_id=1, action=Action.ARM)
    node.step(estimate.t_ns, [ReceivedMessage(message, 1, 0, estimate.t_ns) for message in (estimate, arm)])
    node.arbiter.receive_manual((1e6, 0.0, 0.0), 0)
    report.on_input(estimate)
    for _ in range(5):
        report.on_step([PLAN], 9_000, 1 * S)  # forgotten by the time it is asked
    for k in range(100):
        report.on_step([PLAN], k + 1, (2 + k // 20) * S)
    report.on_step([], 10**6, 6 * S)  # no plan: no cycle
    status = report.status(11 * S + 1, 7_300_000_000, MessageValidator(), ClockOffset(ClockMode.ONE_WAY, 5, None))
    assert status.estimate_age_ns == 300_000_000
    assert status.applied_age_ns is None
    assert (status.cycle_median_us, status.cycle_p99_us) == (51.0, 100.0)
    assert status.error_m == 5.0
    assert status.health == "nominal"
    assert (status.clock, status.clock_error_ns) == ("one-way", None)
    assert status.rejected == {"manual: thrust outside the limits": 1}
    assert report.due_us == 12 * S + 1
    assert shown == [first, status]


def test_its_error_is_that_of_the_origin_wherever_the_estimates_are_measured() -> None:
    """The antenna is 3 m ahead of the vehicle, which looks east: the vehicle is 2 m from its point, the antenna 5 m."""
    vehicle = msgspec.structs.replace(Vehicle.load("paper"), reference_point=ReferencePoint(forward_m=3.0))
    node = ControllerNode(vehicle, references.Point(north_m=0.0, east_m=0.0), ControllerConfig())
    report = ControllerStatusReporter(node)
    estimate = Estimate.at_rest(east_m=5.0, depth_m=0.0, heading_rad=np.pi / 2)
    messages = estimate, Command(command_id=1, action=Action.ARM)
    report.on_step(node.step(0, [ReceivedMessage(message, 1, 0, 0) for message in messages]), 1, 0)
    assert report.status(1, 0, MessageValidator(), SHARED).error_m == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            {},
            "controller | nominal | estimate 0.04 s old | cycle 0.9 ms (p99 2.1) | error 0.25 m"
            " | clock two-way, within 0.9 ms | 1 dropped, 5 rejected",
        ),
        (
            {"estimate_age_ns": None, "clock": ClockMode.SHARED, "rejected": {}, "dropped": 0},
            "controller | nominal | no estimate yet on boat/estimate | cycle 0.9 ms (p99 2.1) | error 0.25 m",
        ),
        (
            {"applied_age_ns": None, "cycle_median_us": None, "source": "gnss", "arrived": True, "rejected": {}},
            "controller | nominal | estimate 0.04 s old | no `applied` messages: plans count as followed"
            " | source gnss | error 0.25 m | arrived | clock two-way, within 0.9 ms | 1 dropped, 0 rejected",
        ),
    ],
)
def test_the_status_line_names_health_input_cycle_error_clock_and_rejections(change: dict[str, Any], line: str) -> None:
    assert status_line(msgspec.structs.replace(STATUS, **change), "boat/estimate") == line


def test_an_arrival_is_one_event_and_stands_in_the_status_and_its_line(node: ControllerNode) -> None:
    report = ControllerStatusReporter(node)
    arrived = msgspec.structs.replace(PLAN, arrived=True)
    events = [event for one in (arrived, PLAN, arrived, arrived) for event in report.on_step([one], 1, 0)]
    assert [(event.kind, event.text) for event in events] == [("arrived", "arrived at the end of the reference")]
    assert report.status(0, 0, MessageValidator(), SHARED).arrived


def test_plans_inputs_and_statuses_reach_the_changes(node: ControllerNode) -> None:
    told: list[str] = []

    report = ControllerStatusReporter(node, tell=lambda _level, _kind, text, **_: told.append(text))
    report.status(0, 0, MessageValidator(), SHARED)
    assert told == ["health: degraded (no estimate yet)", "authority: disarmed"]
    told.clear()
    report.on_input(ClockStep(t_ns=0, input="estimate", publisher=1, step_ns=10**9, certain=True))
    report.on_step([PLAN], 9_000, 1 * S)
    assert told == [
        "the clock of the publisher of `estimate` was set by +1.000 s",
        "health: nominal",
        "authority: controller",
    ]


def test_a_status_is_due_at_once_when_a_plan_has_another_reason_of_its_health(node: ControllerNode) -> None:
    report, degraded = ControllerStatusReporter(node), msgspec.structs.replace(PLAN, health_why="not driving: why")
    for one, due in ((PLAN, True), (PLAN, False), (degraded, True), (degraded, False), (PLAN, True)):
        report.status(S, 0, MessageValidator(), SHARED)
        report.on_step([one], 1, S)
        assert (report.due_us <= S) is due


def test_an_action_of_the_mission_policy_is_an_event_and_a_field_of_the_status() -> None:
    config = ControllerConfig(mission=MissionSettings(leak=True))
    node = ControllerNode(Vehicle.load("paper"), references.load("hover"), config)
    report = ControllerStatusReporter(node)
    node.arbiter.authority = Authority.CONTROLLER
    events = []
    for sequence, detected in enumerate((False, True, True)):
        node.step(sequence * S, [ReceivedMessage(Leak(detected=detected), 1, sequence, sequence * S)])
        events.append([event.text for event in report.on_step([PLAN], 1, sequence * S)])
    assert events == [[], ["mission: surface: leak detected"], []]
    assert report.status(3 * S, 3 * S, MessageValidator(), SHARED).mission_action == "surface"


def test_a_fence_in_force_is_an_event_and_a_change_also_before_the_first_estimate() -> None:
    fence, told = Fence.load("examples/fences/harbour.toml"), list[str]()
    node = ControllerNode(Vehicle.load("paper"), references.load("hover"), ControllerConfig(), fence=fence)
    report = ControllerStatusReporter(node, tell=lambda _level, _kind, text, **_: told.append(text))
    events = []
    inboxes: list[list[Message]] = [[], [], [Command(command_id=1, action=Action.FENCE)], []]
    for cycle, inbox in enumerate(inboxes):
        t_ns = cycle * 300_000_000
        outputs = node.step(t_ns, [ReceivedMessage(message, 1, cycle, t_ns) for message in inbox])
        assert not any(isinstance(message, Plan) for message in outputs)
        events += report.on_step(outputs, 1, cycle * S)
    zones = f"{len(fence.keep_in)} keep-in and {len(fence.keep_out) + len(fence.keep_out_disc)} keep-out zones"
    assert [event.text for event in events] == told == [f"fence in force: {zones}", "no fence in force"]
    assert [event.t_ns for event in events] == [0, 600_000_000]


@pytest.fixture
def metrics(free_port: int) -> Iterator[Metrics]:
    held = Metrics()
    with serving(held, free_port):
        yield held


def asked(port: int, method: str = "GET", path: str = "/metrics", host: str | None = None) -> tuple[int, str]:
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10)) as connection:
        connection.request(method, path, headers={} if host is None else {"Host": host})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


def test_prometheus_reads_every_figure_in_seconds_with_labels_escaped(free_port: int, metrics: Metrics) -> None:
    assert asked(free_port) == (200, "")
    metrics.show(STATUS)
    status, body = asked(free_port)
    assert status == 200
    lines = (line.rsplit(" ", 1) for line in body.splitlines() if not line.startswith("#"))
    samples = {name: float(value) for name, value in lines}
    assert samples['ltv_mpc_input_age_seconds{key="estimate"}'] == 0.04
    assert samples['ltv_mpc_cycle_seconds{quantile="0.99"}'] == 0.0021
    assert samples["ltv_mpc_received_total"] == 450
    assert samples[r'ltv_mpc_rejected_total{reason="depth \"m\"\n"}'] == 2
    assert samples["ltv_mpc_clock_error_seconds"] == 0.0009
    assert samples['ltv_mpc_authority{authority="controller"}'] == 1
    assert samples['ltv_mpc_authority{authority="manual"}'] == 0
    assert samples['ltv_mpc_health{health="nominal"}'] == 1
    assert "ltv_mpc_progress_ratio" not in samples
    named = {line.split()[2] for line in body.splitlines() if line.startswith("# TYPE")}
    assert named == {name.partition("{")[0] for name in samples}
    metrics.show(msgspec.structs.replace(STATUS, clock_error_ns=None))
    assert "clock_error" not in asked(free_port)[1]
    metrics.show(msgspec.structs.replace(STATUS, source="gnss", source_epoch=5, rejected_epoch=6))
    body = asked(free_port)[1]
    assert 'ltv_mpc_source{epoch="5",name="gnss"} 1.0' in body
    assert 'ltv_mpc_source{epoch="6",name="gnss"} 0.0' in body


def test_the_status_names_the_sources_and_shows_the_error_of_the_one_in_use(node: ControllerNode) -> None:
    report = ControllerStatusReporter(node)
    for k in range(12):
        t_ns = k * S // 10
        inbox = [Command(command_id=1, action=Action.ARM)] if k == 0 else []
        for epoch, north_m in ((5, 3.0), (6, 30.0)):
            estimate = msgspec.structs.replace(Estimate.at_rest(north_m=north_m, depth_m=0.0), t_ns=t_ns)
            report.on_input(estimate)
            node.receive(ReceivedMessage(estimate, epoch, k, t_ns))
        report.on_step(node.step(t_ns, [ReceivedMessage(message, 1, 0, t_ns) for message in inbox]), 1, 0)
    status = report.status(0, t_ns, MessageValidator(), SHARED)
    assert (status.source, status.source_epoch) == ("default", 5)
    assert (status.rejected_epoch, status.rejected_estimates) == (6, 12)
    assert status.error_m == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("method", "path", "host", "code"),
    [
        ("GET", "/metrics", "localhost", 200),
        ("GET", "/metrics", "evil.example", 403),
        ("GET", "/metrics", "", 403),
        ("GET", "/", None, 404),
        ("GET", "/metrics/../etc/passwd", None, 404),
        ("POST", "/metrics", None, 501),
    ],
)
def test_nothing_else_is_answered_and_no_other_name_is_taken(free_port, metrics, method, path, host, code) -> None:
    metrics.show(STATUS)
    assert asked(free_port, method, path, host)[0] == code
