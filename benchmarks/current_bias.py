"""Bias of the current beside the thrust loss detector: paired descents in lock step, with and without the bias.

    .venv/bin/python -m benchmarks.current_bias [--seeds N] [--first-seed N] [--only TEXT]
                                              [--sd-mps SD] [--sensors paper|realistic]

The state is known, unless --sensors names the sensors of the full loop. Error: mean distance of the true position from
the reference over 90 s. A thruster that fails does so from 20 s on.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.disturbance import STILL_WATER
from ltv_mpc.messages import Applied, CurrentProfile, Disturbance, Estimate, Message, ModelCheck, Plan, Truth
from ltv_mpc.node import Due, Node, ReceivedMessage
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from services.tools.lockstep_run import LATEST
from sim.faults.node_wrapper import NodeWrapper
from sim.faults.world import DisturbanceSource
from sim.scheduler import LockStep, Observation

FAILS_NS, RUN_S = 20_000_000_000, 90
SPEED_MPS = 0.04
"""Current that the profile lacks."""

TURN_RAD = 2.4
"""Angle by which it turns from seed to seed."""

Told = Callable[[Estimate], Estimate]
"""Function that returns the controller's estimate for a true one."""


class Case(NamedTuple):
    """What happens, and which current the estimates contain: ``told`` makes a function for a seed."""

    told: Callable[[int], Told] = lambda _seed: lambda estimate: estimate
    settings: tuple[str, ...] = ()
    share: float = 1.0  # of the reported thrust that one thruster delivers from FAILS_NS on


def nothing(_seed: int) -> Told:
    """Leave out the current."""
    return lambda estimate: msgspec.structs.replace(estimate, current=None)


def lacking(seed: int) -> Told:
    """Leave 4 cm/s out of the profile, the same at all depths."""
    away = SPEED_MPS * math.cos(TURN_RAD * seed), SPEED_MPS * math.sin(TURN_RAD * seed)

    def told(estimate: Estimate) -> Estimate:
        profile = estimate.current or STILL_WATER
        north_mps, east_mps = profile.north_mps - away[0], profile.east_mps - away[1]
        current = msgspec.structs.replace(profile, north_mps=north_mps, east_mps=east_mps)
        return msgspec.structs.replace(estimate, current=current)

    return told


def outdated(_seed: int) -> Told:
    """Leave the change of the current with time out: every estimate has the profile of the first one."""
    first: list[CurrentProfile | None] = []

    def told(estimate: Estimate) -> Estimate:
        first.append(estimate.current)
        return msgspec.structs.replace(estimate, current=first[0])

    return told


WAVES = "water.feature.kind=waves", "water.feature.period_s=60"
FAST_WAVES = "water.feature.kind=waves", "water.feature.period_s=20"
CASES = {
    "nothing wrong": Case(),
    "thruster delivers half": Case(share=0.5),
    "thruster stops": Case(share=0.0),
    "internal waves": Case(settings=WAVES),
    "internal waves of 20 s that the profile lacks": Case(told=outdated, settings=FAST_WAVES),
    "profile lacks 4 cm/s": Case(told=lacking),
    "no profile": Case(told=nothing),
    "no profile, thruster delivers half": Case(told=nothing, share=0.5),
    "no profile, thruster stops": Case(told=nothing, share=0.0),
    "no profile, internal waves": Case(told=nothing, settings=WAVES),
}


class Listener(NodeWrapper):
    """Controller node whose estimates are changed."""

    def __init__(self, node: Node, told: Told) -> None:
        super().__init__(node)
        self._told = told

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Step the controller with the changed estimates."""
        return self._node.steps([(t_ns, [self._changed(received) for received in inbox]) for t_ns, inbox in due])

    def _changed(self, received: ReceivedMessage) -> ReceivedMessage:
        message = received.message
        if not isinstance(message, Estimate):
            return received
        return msgspec.structs.replace(received, message=self._told(message))


class Figures(NamedTuple):
    """Figures of one run."""

    error_m: float
    thrust_N: float
    alarm: float  # 1 if the model check raised an alarm


class Watcher:
    """Observer that collects the figures of one run."""

    def __init__(self) -> None:
        self._off_m: list[float] = []
        self._thrust_N: list[float] = []
        self._target_m = (0.0, 0.0)
        self._alarm = False

    def published(self, _node: str, message: ReceivedMessage) -> None:
        """Handle one message."""
        match message.message:
            case Truth() as truth if truth.t_ns >= 0:
                north, east = truth.position_m[:2]
                self._off_m.append(math.hypot(north - self._target_m[0], east - self._target_m[1]))
            case Plan() as plan if plan.reference_m is not None:
                self._target_m = plan.reference_m
            case Applied() as applied:
                self._thrust_N.append(float(np.abs(applied.command_N[:2]).mean()))
            case ModelCheck() as check:
                self._alarm |= check.alarm
            case _:
                pass

    def figures(self) -> Figures:
        """Return the figures."""
        return Figures(float(np.mean(self._off_m)), float(np.mean(self._thrust_N)), float(self._alarm))


def fly(case: Case, seed: int, sd_mps: float, state: tuple[str, ...]) -> Figures:
    """Return the figures of one run."""
    settings = f"run.seed={seed}", f"run.duration_s={RUN_S}", f"controller.disturbance.sd_mps={sd_mps}"
    run = resolve("descent", [Override("benchmark", (*settings, *case.settings, *state))])
    *others, controller = make_nodes(run)
    nodes: list[Node] = [*others, Listener(controller, case.told(seed))]
    if case.share < 1.0:
        scale = (case.share, 1.0, 1.0) if seed % 2 else (1.0, case.share, 1.0)
        loss = Disturbance(end_t_ns=run.scenario.end_ns, thrust_scale=scale)
        nodes.insert(1, DisturbanceSource([(FAILS_NS, loss)]))
    watcher = Watcher()
    types: frozenset[type[Message]] = frozenset((Truth, Plan, Applied, ModelCheck))
    lockstep = LockStep(
        nodes, start_ns=run.scenario.start_ns, observation=Observation(watcher, types=types), latest=LATEST
    )
    lockstep.advance(run.scenario.end_ns)
    return watcher.figures()


def main() -> None:
    """Fly all pairs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=800)
    parser.add_argument("--only", default="", help="cases that have this in their name")
    parser.add_argument("--sd-mps", type=float, default=0.1, help="prior of the bias where it is on")
    parser.add_argument("--sensors", choices=("paper", "realistic"))
    options = parser.parse_args()
    state = ("run.perfect_state=true",) if options.sensors is None else (f"sensors={options.sensors}",)
    print("| case | error, off (m) | on (m) | on less off (m), 95 % | thrust, off and on (N) | alarms, off and on |")
    print("|---|---|---|---|---|---|")
    for name, case in CASES.items():
        if options.only not in name:
            continue
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        off, on = np.array([[fly(case, seed, sd, state) for seed in seeds] for sd in (0.0, options.sd_mps)])
        change = on[:, 0] - off[:, 0]
        interval = 1.96 * change.std(ddof=1) / math.sqrt(len(change)) if len(change) > 1 else math.nan
        print(
            f"| {name} | {off[:, 0].mean():.4f} | {on[:, 0].mean():.4f} | {change.mean():+.4f} +- {interval:.4f} "
            f"| {off[:, 1].mean():.1f}, {on[:, 1].mean():.1f} | {off[:, 2].sum():.0f}, {on[:, 2].sum():.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
