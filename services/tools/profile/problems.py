"""Problems of a latency profile: closed loops in lock step with the state known, or the cycles of a recorded run.

In each episode a node stands in the controller's place: it has the controller's schedule and receives its inboxes. Each
control cycle solves one QP. Three kinds of episodes are simulated, all in a current drawn with a standard deviation of
4 cm/s:

    descent            the paper's descent
    unknown current    the same, with estimates that do not contain the current
    hard               a descent to a point 2 m north of the vehicle, with an initial heading within 3 rad of north
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.config import STAGE_NS, ResolvedConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Estimate, Message
from ltv_mpc.node import Inbox, Node
from ltv_mpc.references import Point, Reference
from ltv_mpc.vehicle.parameters import Vehicle
from services.replay import node_replay
from services.replay.node_replay import NodeReplay
from services.replay.nodes import Run
from services.replay.what_if import WhatIf
from services.run import folder
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from services.tools import lockstep_run
from sim.sensors.node import Sensors

DESCENT, UNKNOWN, HARD = "descent", "unknown current", "hard"

MAX_DESCENT_CYCLES = 650
"""Largest number of cycles of one descent: 195 s, the duration of the paper's."""

HARD_CYCLES = 40
"""Largest number of cycles of one hard episode: 12 s, in which the vehicle turns, reaches its point and stops there."""

TARGET_NORTH_M, MAX_HEADING_RAD = 2.0, 3.0
"""Distance north to the point of a hard episode (m), and the largest initial heading to either side of north (rad)."""

DEFAULT = 0
"""In the place of a number of stages: the horizon that the controller has without settings, with stages that grow."""

Feed = Callable[[Node, Callable[[], bool]], None]
"""Callback that steps the given node in the controller's place until the given test is True, or no input is left."""


class Episode(NamedTuple):
    """Closed loop to measure. ``config`` is common to all candidates; each brings its own solver."""

    kind: str  # "descent", "unknown current", "hard", or the name of a recorded run
    vehicle: Vehicle
    reference: Reference
    config: ResolvedConfig
    cycles: int  # number of measured cycles
    feed: Feed


def simulated(stages: int, cycles: int, seed: int) -> list[Episode]:
    """Return simulated episodes with ``cycles`` cycles in total: half of them descents, a quarter each other kind.

    Parameters
    ----------
    stages : horizon of the controller; ``DEFAULT``: without settings.
    cycles : total number of cycles.
    seed : seed of the first episode of each kind; the next episodes count up from it.
    """
    known = -(-cycles // 2)
    unknown = (cycles - known) // 2
    parts = (
        (DESCENT, known, MAX_DESCENT_CYCLES),
        (UNKNOWN, unknown, MAX_DESCENT_CYCLES),
        (HARD, cycles - known - unknown, HARD_CYCLES),
    )
    return [
        _episode(kind, stages, length, seed + i)
        for kind, total, longest in parts
        for i, length in enumerate(_episode_lengths(total, longest))
    ]


def recorded(run: str, stages: int, cycles: int) -> list[Episode]:
    """Return the first ``cycles`` cycles of a recorded run as one episode, at a horizon of ``stages``.

    The vehicle, the reference and the controller are the run's own, but the controller has this horizon, or with
    ``DEFAULT`` its own, and solves one QP a cycle. Raises ``ConfigError``.

    Parameters
    ----------
    run : the run's folder, its run.mcap, or ``latest``.
    stages : horizon of the controller.
    cycles : number of cycles to measure.
    """
    replayed = Run(folder.find(run))
    if ControllerNode.name not in replayed.names:
        raise ConfigError("option --run", "", "has no controller: name another run", value=run)
    node = replayed.make(ControllerNode.name)
    assert isinstance(node, ControllerNode)
    own = node.controller
    config = msgspec.structs.replace(own.config, sqp_iterations=1)
    if stages != DEFAULT:
        config = msgspec.structs.replace(config, horizon_s=seconds(stages), max_stages=max(stages, 2))

    def feed(node: Node, is_done: Callable[[], bool]) -> None:
        replay = NodeReplay(node.name, lambda _: node, lambda _: WhatIf(node.name))
        node_replay.feed(replayed.recording(), [replay], is_done)

    name = replayed.path.resolve().parent.name
    return [Episode(name, own.vehicle, own.follower.reference, config, cycles, feed)]


def seconds(stages: int) -> float:
    """Return the length (s) of a horizon of this number of stages."""
    return stages * STAGE_NS / 1e9


def length_s(config: ResolvedConfig) -> float:
    """Return the length of a controller's horizon (s)."""
    return float(config.knots[-1]) * seconds(1)


def _episode_lengths(total: int, longest: int) -> Iterator[int]:
    """Generate numbers of cycles, each at most ``longest``, that add up to ``total``."""
    while total > 0:
        yield min(total, longest)
        total -= longest


def _episode(kind: str, stages: int, cycles: int, seed: int) -> Episode:
    settings = ["run.perfect_state=true", "run.compute_delay_s=0", "controller.sqp_iterations=1", f"run.seed={seed}"]
    if stages != DEFAULT:
        settings += [f"controller.horizon_s={seconds(stages)!r}", f"controller.max_stages={max(stages, 2)}"]
    if kind == UNKNOWN:
        settings.append("water.sd_mps=0.04")
    if kind == HARD:  # the point lies to the north, so the heading is the angle to the direction of the point
        heading = np.random.default_rng(seed).uniform(-MAX_HEADING_RAD, MAX_HEADING_RAD)
        settings.append(f"plant.heading_rad={heading:.6f}")
    run_config = resolve("descent", [Override("profile", settings)])
    if kind == HARD:
        reference = Point(north_m=TARGET_NORTH_M, east_m=0.0, depth_m=40.0, start_s=0.0)
        run_config = dataclasses.replace(run_config, reference=reference)

    def simulate(node: Node, is_done: Callable[[], bool]) -> None:
        others = [other for other in make_nodes(run_config) if not isinstance(other, ControllerNode)]
        if kind == UNKNOWN:
            others = [_WithoutCurrent(other) if isinstance(other, Sensors) else other for other in others]
        lockstep_run.simulate(run_config, nodes=[*others, node], stop=is_done)

    return Episode(kind, run_config.vehicle, run_config.reference, run_config.controller, cycles, simulate)


class _WithoutCurrent:
    """Sensors node whose estimates do not contain the current."""

    def __init__(self, sensors: Node) -> None:
        self.name, self.schedule = sensors.name, sensors.schedule
        self.reads, self.writes = sensors.reads, sensors.writes
        self._step = sensors.step

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        return [
            msgspec.structs.replace(message, current=None) if isinstance(message, Estimate) else message
            for message in self._step(t_ns, inbox)
        ]
