"""Problems of a latency profile: closed loops in lock step with the state known, or the cycles of a recorded run.

Each episode has a node in the controller's place step as the controller would, on the same inboxes. Three kinds are
simulated: the paper's descent; the same in a current of 4 cm/s that the controller does not know; and hard ones, a
descent onto a line 2 m off with the heading up to 3 rad from it. All with one QP a cycle.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc import references
from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Estimate, Message, StepRecord
from ltv_mpc.node import Due, Node, ReceivedMessage
from ltv_mpc.references import Point, Reference
from ltv_mpc.vehicle.parameters import Vehicle
from services.recording.reader import Recording
from services.run import folder
from services.run.folder import RunFolder
from services.run.nodes import make_nodes
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from sim.scheduler import LockStep
from sim.sensors.node import Sensors

LONGEST_DESCENT = 650
"""Cycles of one descent: as long as the paper's, 195 s."""

HARD_CYCLES = 40
"""Cycles of one hard episode: 12 s, in which the vehicle turns, reaches its line and stops there."""

OFF_M, OFF_RAD = 2.0, 3.0
"""How far a hard episode begins from its line, and the most that its heading is off the way there."""

Feed = Callable[[Node, Callable[[], bool]], None]
"""Steps the node that stands in the controller's place until the second says that it is enough, or nothing is left."""


class Episode(NamedTuple):
    """Closed loop to measure. ``config`` does not name a candidate's solver yet."""

    kind: str  # "descent", "unknown current", "hard", or the name of a recorded run
    vehicle: Vehicle
    reference: Reference
    config: ControllerConfig
    cycles: int  # to be measured
    feed: Feed


def simulated(stages: int, cycles: int, seed: int) -> list[Episode]:
    """Return episodes of ``cycles`` cycles in all at a horizon of ``stages``: half descents, a quarter each of the
    others.
    """
    known = -(-cycles // 2)
    unknown = (cycles - known) // 2
    lengths = {
        _descent: (known, LONGEST_DESCENT),
        _unknown_current: (unknown, LONGEST_DESCENT),
        _hard: (cycles - known - unknown, HARD_CYCLES),
    }
    return [
        make(stages, part, seed + i)
        for make, (total, longest) in lengths.items()
        for i, part in enumerate(_parts(total, longest))
    ]


def recorded(run: str, stages: int, cycles: int) -> list[Episode]:
    """Return the cycles of RUN (its folder, its run.mcap or ``latest``), from its first, at a horizon of ``stages``.

    The controller is that of the run's ``config/`` but for its horizon, with one QP a cycle. Raises ``ConfigError``.
    """
    held = _held(run)
    config = ControllerConfig.load(str(held.config("controller")))
    return [
        Episode(
            kind=held.path.resolve().name,
            vehicle=Vehicle.load(str(held.config("vehicle"))),
            reference=references.load(str(held.config("reference"))),
            config=msgspec.structs.replace(
                config, horizon_s=seconds(stages), max_stages=max(stages, 2), sqp_iterations=1
            ),
            cycles=cycles,
            feed=lambda node, enough: _replay(held.recording, node, enough),
        )
    ]


def seconds(stages: int) -> float:
    """Return the length of a horizon (s)."""
    return stages * STAGE_NS / 1e9


# --- simulated -------------------------------------------------------------------------------------------------------


def _parts(total: int, longest: int) -> Iterator[int]:
    while total > 0:
        yield min(total, longest)
        total -= longest


def _descent(stages: int, cycles: int, seed: int) -> Episode:
    return _episode("descent", _run_config(stages, seed), cycles)


def _unknown_current(stages: int, cycles: int, seed: int) -> Episode:
    run_config = _run_config(stages, seed, "water.sd_mps=0.04")
    return _episode("unknown current", run_config, cycles, told_of_current=False)


def _hard(stages: int, cycles: int, seed: int) -> Episode:
    # The point lies to the north: a heading of psi is off the way there by psi.
    heading = np.random.default_rng(seed).uniform(-OFF_RAD, OFF_RAD)
    run_config = _run_config(stages, seed, f"plant.heading_rad={heading:.6f}")
    reference = Point(north_m=OFF_M, east_m=0.0, depth_m=40.0, start_s=0.0)
    return _episode("hard", dataclasses.replace(run_config, reference=reference), cycles)


def _run_config(stages: int, seed: int, *settings: str) -> RunConfig:
    horizon = (f"controller.horizon_s={seconds(stages)!r}", f"controller.max_stages={max(stages, 2)}")
    common = ("run.perfect_state=true", "controller.sqp_iterations=1", *horizon)
    return resolve(
        "descent", [Override("option --seed", [f"run.seed={seed}"]), Override("profile", [*common, *settings])]
    )


def _episode(kind: str, run_config: RunConfig, cycles: int, *, told_of_current: bool = True) -> Episode:
    def feed(node: Node, enough: Callable[[], bool]) -> None:
        others = [other for other in make_nodes(run_config) if not isinstance(other, ControllerNode)]
        if not told_of_current:
            others = [_Untold(other) if isinstance(other, Sensors) else other for other in others]
        t_ns = run_config.scenario.start_ns
        lockstep = LockStep([*others, node], start_ns=t_ns, latest=lockstep_run.LATEST)
        while not enough():
            lockstep.advance(t_ns)
            t_ns += run_config.scenario.controller.period_ns

    return Episode(kind, run_config.vehicle, run_config.reference, run_config.scenario.controller, cycles, feed)


class _Untold:
    """Sensors whose estimate does not contain the current."""

    def __init__(self, sensors: Node) -> None:
        self.name, self.schedule, self.reads, self.writes = (
            sensors.name,
            sensors.schedule,
            sensors.reads,
            sensors.writes,
        )
        self._steps = sensors.steps

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        return [
            [
                msgspec.structs.replace(signal, current=None) if isinstance(signal, Estimate) else signal
                for signal in signals
            ]
            for signals in self._steps(due)
        ]


# --- recorded --------------------------------------------------------------------------------------------------------


def _held(run: str) -> RunFolder:
    path = folder.ROOT / folder.LATEST if run == folder.LATEST else Path(run)
    held = RunFolder(path.parent if path.suffix == ".mcap" else path)
    if not held.recording.is_file():
        problem = f"must be a run's folder, its run.mcap, or {folder.LATEST}: there is no {held.recording}"
        raise ConfigError("option --run", "", problem, value=run)
    return held


def _replay(recording: Path, node: Node, enough: Callable[[], bool]) -> None:
    """Replay every step of the recorded node with the node's name, on the recorded inbox."""
    for t_ns, inbox in _steps(recording, node):
        if enough():
            return
        node.steps([(t_ns, inbox)])


def _steps(recording: Path, node: Node) -> Iterable[Due]:
    """Generate time and inbox of each step; messages that the recorder lost are missing."""
    reads = frozenset(node.reads)
    heard: dict[tuple[str, int, int], Message] = {}
    for message in Recording(recording):
        if message.kind is StepRecord and message.plain["node"] == node.name:
            record, _ = message.typed()
            assert isinstance(record, StepRecord)
            inbox = [
                ReceivedMessage(heard.pop(name), entry.epoch, entry.sequence, entry.received_t_ns)
                for entry in record.inbox
                if (name := (entry.key, entry.epoch, entry.sequence)) in heard
            ]
            yield record.t_ns, inbox
        elif message.kind in reads:
            signal, header = message.typed()
            heard[message.key, header.epoch, header.sequence] = signal
