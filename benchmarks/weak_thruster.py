"""Benefit of the reduced box of a weak thruster.

    .venv/bin/python -m benchmarks.weak_thruster [--seeds N] [--state known|estimated] [--first-seed N]

Descents in lock step in which one thruster, in turn port and starboard, delivers 0, 30 or 60 % of what it reports from
30 s to 80 s. Each seed is flown twice, with ``controller.reduce_weak_thruster`` true and false; the table pairs them.
Error: distance of the true position from the reference during the loss, less what the estimate was off at its start.
Saturated: share of this time with a command at its minimum or maximum.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import Applied, Disturbance, Estimate, Message, Plan, Triple, Truth
from ltv_mpc.node import ReceivedMessage
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from services.tools.lockstep_run import LATEST
from sim.faults.world import DisturbanceSource
from sim.scheduler import LockStep, Observation

BEGIN_NS, END_NS, RUN_S = 30_000_000_000, 80_000_000_000, 110
SHARES = 0.0, 0.3, 0.6
AT_LIMIT_N = 0.01


class Loss(NamedTuple):
    """Figures of one run during the loss."""

    mean_m: float
    max_m: float
    saturated: float
    after_m: float  # mean error after the loss


class Watcher:
    """Observer that collects positions, references and commands."""

    def __init__(self) -> None:
        self.true: list[tuple[int, float, float]] = []
        self.reference: list[tuple[int, float, float]] = []
        self.command: list[tuple[int, float, float]] = []
        self.offset_m = np.zeros(2)
        """What the estimate is off at the begin of the loss."""

    def published(self, _node: str, message: ReceivedMessage) -> None:
        """Handle one message."""
        match message.message:
            case Truth() as truth:
                self.true.append((truth.t_ns, *truth.position_m[:2]))
            case Estimate() as estimate if estimate.t_ns <= BEGIN_NS:
                self.offset_m = np.array(self.true[-1][1:]) - (estimate.north_m, estimate.east_m)
            case Plan() as plan if plan.reference_m is not None:
                self.reference.append((int(plan.t_ns[0]), *plan.reference_m))
            case Applied() as applied:
                self.command.append((applied.t_ns, *applied.command_N[:2]))
            case _:
                pass


def fly(seed: int, share: float, *, known: bool, reduced: bool) -> Loss:
    """Return the figures of one run."""
    switches = f"run.perfect_state={str(known).lower()}", f"controller.reduce_weak_thruster={str(reduced).lower()}"
    run = resolve("descent", [Override("benchmark", (f"run.seed={seed}", f"run.duration_s={RUN_S}", *switches))])
    scale: Triple = (share, 1.0, 1.0) if seed % 2 else (1.0, share, 1.0)
    nodes = make_nodes(run)
    nodes.insert(1, DisturbanceSource([(BEGIN_NS, Disturbance(end_t_ns=END_NS, thrust_scale=scale))]))
    watcher = Watcher()
    types: frozenset[type[Message]] = frozenset((Truth, Estimate, Plan, Applied))
    lockstep = LockStep(
        nodes, start_ns=run.scenario.start_ns, observation=Observation(watcher, types=types), latest=LATEST
    )
    lockstep.advance(run.scenario.end_ns)
    true, reference, command = (np.array(x) for x in (watcher.true, watcher.reference, watcher.command))
    wanted = np.stack([np.interp(true[:, 0], reference[:, 0], reference[:, i]) for i in (1, 2)], axis=1)
    error = np.hypot(*(true[:, 1:] - wanted - watcher.offset_m).T)
    during = (true[:, 0] >= BEGIN_NS) & (true[:, 0] < END_NS)
    low, high = (np.array([getattr(t, name) for t in run.vehicle.thrusters[:2]]) for name in ("min_N", "max_N"))
    held = command[(command[:, 0] >= BEGIN_NS) & (command[:, 0] < END_NS), 1:]
    saturated = ((held <= low + AT_LIMIT_N) | (held >= high - AT_LIMIT_N)).any(axis=1).mean()
    after = error[true[:, 0] >= END_NS + 10_000_000_000].mean()
    return Loss(float(error[during].mean()), float(error[during].max()), float(saturated), float(after))


def main() -> None:
    """Fly all pairs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=6000)
    parser.add_argument("--state", choices=("known", "estimated"), default="known")
    options = parser.parse_args()
    print("| share | figure | told only | box reduced | better in | mean change |\n|---|---|---|---|---|---|")
    for share in SHARES:
        pairs = np.array(
            [
                [fly(seed, share, known=options.state == "known", reduced=reduced) for reduced in (False, True)]
                for seed in range(options.first_seed, options.first_seed + options.seeds)
            ]
        )
        for k, name in enumerate(("mean error (m)", "largest error (m)", "saturated", "mean error afterwards (m)")):
            without, reduced = pairs[:, 0, k], pairs[:, 1, k]
            change = reduced - without
            spread = change.std(ddof=1) / np.sqrt(len(change)) if len(change) > 1 else 0.0
            print(
                f"| {share:.0%} | {name} | {without.mean():.3f} | {reduced.mean():.3f} | "
                f"{(change < 0.0).sum()} of {len(change)} | {change.mean():+.4f} +- {spread:.4f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
