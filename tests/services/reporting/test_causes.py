"""Runs with one known cause each: the sentences name it, and the run that follows their advice is better."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from importlib.resources import files
from typing import Any

import msgspec
import numpy as np
import pytest

from benchmarks.faults.effects import Interval, NodeWrapper
from benchmarks.faults.sensor_faults import Failure, FaultySensors, SensorFault
from ltv_mpc import simulate
from ltv_mpc.messages import Estimate, Message, Plan
from ltv_mpc.node import Inbox, Node, ReceivedMessage
from services.reporting.assessment import assessment, next_option
from services.tools import python_run

FROM_NS = 3_000_000_000
"""Vehicle time at which a fault begins."""

KNOWN: dict[str, Any] = {"seed": 3, "perfect_state": True}
RIGHT: dict[str, Any] = {"fault": "", "fence": "", "vehicle": "paper", "compute_delay_s": 0.0, "plant": {}}
SHORT = {**KNOWN, **RIGHT, "duration_s": 15.0, "surface_time_s": 1.0, "water": {"sd_mps": 0.15}}
LONG = {**KNOWN, **RIGHT, "duration_s": 35.0, "water": {"sd_mps": 0.1}}
FILES = {
    "slow.toml": ("ltv_mpc.vehicle.files", {"slew_N_per_s = 100.0": "slew_N_per_s = 5.0"}),
    "noisy.toml": (
        "ltv_mpc.localisation.files",
        {"per_rts = 3.3e-4": "per_rts = 3.3e-2", "sd_mps = 0.01": "sd_mps = 0.3"},
    ),
}
"""Files made of the shipped paper.toml, with the package of that one and the values that are replaced."""
FENCE = 'margin_m = 0.5\n[[keep_out_disc]]\nname = "buoy"\nradius_m = 2.5\ncentre = { north_m = 3.0, east_m = 0.0 }\n'


def mismatch(**factors: float) -> dict[str, Any]:
    return {"plant": {"mismatch": factors}}


class _OtherSource(NodeWrapper):
    """Plant whose thrusters are driven by other plans than those of the controller."""

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        if t_ns < FROM_NS:
            return self._node.step(t_ns, inbox)
        return self._node.step(t_ns, [self._other(received) for received in inbox])

    def _other(self, received: Any) -> Any:
        if not isinstance(received.message, Plan):
            return received
        other = msgspec.structs.replace(received.message, thrust_N=np.zeros_like(received.message.thrust_N))
        return msgspec.structs.replace(received, message=other)


class _LatePlans(NodeWrapper):
    """Plant whose link stalls for 2 s of each 4 s: plans then arrive together, after their start."""

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self._held: list[ReceivedMessage] = []

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        plans = [received for received in inbox if isinstance(received.message, Plan)]
        others = [received for received in inbox if received not in plans]
        self._held += plans
        if t_ns % 4_000_000_000 < 2_000_000_000:
            return self._node.step(t_ns, others)
        arrived = [msgspec.structs.replace(one, received_t_ns=max(one.received_t_ns, t_ns)) for one in self._held]
        self._held = []
        return self._node.step(t_ns, [*others, *arrived])


def dropout(node: Node) -> Node:
    return FaultySensors(node, [SensorFault(Estimate, Failure.OFF, Interval(FROM_NS, 10**12), 0.0, 0)])


FAULTS: dict[str, tuple[int, Callable[[Node], Node]]] = {
    "dropout": (1, dropout),
    "other": (0, _OtherSource),
    "late": (0, _LatePlans),
}
"""Node of a run by its place, and what replaces it."""

FLOWN: dict[str, dict[str, Any]] = {}
"""Summaries by their settings, because several causes have the same run without it."""


CAUSES: dict[str, tuple[str, dict[str, Any], list[str], str | None, dict[str, Any]]] = {
    "short horizon": (
        "paper-2.5s",
        {**KNOWN, "duration_s": 20.0},
        ["The horizon of 2.4 s is shorter than a turn and a stop: 13.8 s is proposed.", "A plan that ends before"],
        "--horizon-s 13.8",
        {"horizon_s": 13.8},
    ),
    "no thrust": ("paper-no-control", {**KNOWN, "duration_s": 8.0}, ["thrusts were zero"], None, {"lateral": True}),
    "drift": (
        "descent",
        {"seed": 3, "duration_s": 12.0},
        ["Drift of the estimate", "Better sensors"],
        "--perfect-state",
        {"perfect_state": True},
    ),
    "current above the top speed": (
        "hover",
        {**KNOWN, "duration_s": 12.0, "surface_time_s": 1.0, "water": {"sd_mps": 1.0}},
        ["was not sufficient", "The thrust limits bound it", "weaker current"],
        None,
        {"water": {"sd_mps": 0.1}},
    ),
    "weak thrusters": (
        "hover",
        LONG | mismatch(thrust=0.2),
        ["thrust differs", "The thrusters are weak"],
        None,
        RIGHT,
    ),
    "one weak thruster": (
        "hover",
        SHORT | mismatch(port_thrust=0.3),
        ["port thruster weak", "The thrusters are weak"],
        None,
        RIGHT,
    ),
    "wrong file": (
        "hover",
        LONG | mismatch(mass=3.0),
        ["mass ahead differs", "The vehicle file is wrong"],
        None,
        RIGHT,
    ),
    "delay": (
        "hover",
        {**SHORT, "compute_delay_s": 1.5},
        ["The delay bounds it"],
        "--set run.compute_delay_s=0",
        RIGHT,
    ),
    "slew": ("hover", {**SHORT, "vehicle": "slow.toml"}, ["The slew limit bounds it"], None, RIGHT),
    "noise": (
        "hover",
        {"seed": 3, "duration_s": 10.0, "surface_time_s": 5.0, "sensors": "noisy.toml"},
        ["Noise of the estimate"],
        "--perfect-state",
        {"perfect_state": True},
    ),
    "late plans": (
        "hover",
        {**SHORT, "fault": "late"},
        ["Plans that come too late", "plans came too late"],
        None,
        RIGHT,
    ),
    "fence": ("hover", {**SHORT, "fence": "fence.toml"}, ["The fence bounds it"], None, RIGHT),
    "dropout": ("hover", {**SHORT, "fault": "dropout"}, ["no new estimates", "dropped out"], None, RIGHT),
    "other source of thrust": (
        "hover",
        {**SHORT, "fault": "other"},
        ["by somebody else", "Another source of thrust"],
        None,
        RIGHT,
    ),
}
"""By cause: scenario, settings, words of the sentences, the option that they propose, settings without the cause."""


@pytest.mark.parametrize("cause", CAUSES)
def test_the_cause_is_named_and_what_reduces_it_is_better(cause, tmp_path, monkeypatch) -> None:
    scenario, changes, words, option, advised = CAUSES[cause]
    for name, (package, values) in FILES.items():
        text = files(package).joinpath("paper.toml").read_text()
        for before, after in values.items():
            assert before in text
            text = text.replace(before, after)
        (tmp_path / name).write_text(text)
    (tmp_path / "fence.toml").write_text(FENCE)
    monkeypatch.chdir(tmp_path)
    make_nodes = python_run.make_nodes

    def fly(fault: str = "", **settings: Any) -> dict[str, Any]:
        flight = json.dumps([scenario, fault, settings], sort_keys=True)
        if flight in FLOWN:
            return FLOWN[flight]

        def with_fault(*args: Any, **options: Any) -> list[Node]:
            nodes = make_nodes(*args, **options)
            if fault:
                place, faulty = FAULTS[fault]
                nodes[place] = faulty(nodes[place])
            return nodes

        monkeypatch.setattr(python_run, "make_nodes", with_fault)
        return FLOWN.setdefault(flight, dict(simulate(scenario, **settings).summary))

    summary = fly(**changes)
    found = assessment(summary)
    places = [next(i for i, sentence in enumerate(found) if text in sentence) for text in words]
    assert places == sorted(places)
    assert next_option(summary) == option
    if "horizon" in words[0]:
        assert places[0] == 0
    better = fly(**(changes | advised))
    assert better["true_error_m"]["mean"] < summary["true_error_m"]["mean"]
