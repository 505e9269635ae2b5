"""When the alarm "the vehicle does not do what its model says" comes, and when it must not.

    .venv/bin/python -m benchmarks.model_alarm [--nominal N] [--losses N] [--duration-s S] [--out FILE.json]

Nominal: descents in lock step with mass, drag and thrust off by 10 % at most: in every second run each of the three
drawn from -10 % to 10 %, in the others all at the edge that looks most like a loss (thrust 0.9, drag and mass 1.1). The
state is known in half of them, estimated in the other half. Every alarm is a false one.

Losses: every 30 s port, starboard or both deliver 30 % less than they report, for 8 s. The cost of a loss is the
impulse that is missing since, the integral of what was reported less what was delivered; the table has it at the alarm,
beside the delay, by the thrust at the time. Seeds from 1000 up: none that the threshold was looked at with.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ltv_mpc.node import Arrival, Grid, Inbox, Node
from ltv_mpc.signals import Applied, Disturbance, ModelCheck, Signal, Triple, Truth
from services.run.locked import LATEST, nodes
from services.run.situation import Override, resolve
from sim.lockstep import LockStep

S = 1_000_000_000
EVERY_NS, LASTS_NS, FIRST_NS = 30 * S, 8 * S, 6 * S
SHARES: tuple[tuple[str, Triple], ...] = (
    ("both", (0.7, 0.7, 1.0)),
    ("port", (0.7, 1.0, 1.0)),
    ("starboard", (1.0, 0.7, 1.0)),
)
FIRST_SEED = 1000
EDGE = ("plant.mismatch.thrust=0.9", "plant.mismatch.drag=1.1", "plant.mismatch.mass=1.1")
BOUND = 10.0
"""N s that a loss of 30 % may have cost when the alarm comes."""


class Loss(NamedTuple):
    """One loss, from its beginning to the alarm."""

    state: str
    of: str
    at_s: float
    thrust_N: float  # mean of |port| + |starboard| until the alarm, as reported
    delay_s: float | None  # None: no alarm
    cost_Ns: float | None  # when the alarm came
    before_Ns: float | None  # at the cycle before


class Breaker:
    """A node that takes thrust away, again and again."""

    name = "breaker"
    schedule = Grid(100_000_000)
    reads: tuple[type[Signal], ...] = ()
    writes: tuple[type[Signal], ...] = (Disturbance,)

    def __init__(self, first: int) -> None:
        """With which of ``SHARES`` it begins."""
        self.losses: list[tuple[int, str]] = []
        self._first = first

    def step(self, t_ns: int, inbox: Inbox) -> list[Signal]:
        """A loss at its time."""
        del inbox
        since_ns = t_ns - FIRST_NS
        if since_ns < 0 or since_ns % EVERY_NS:
            return []
        name, scale = SHARES[(self._first + since_ns // EVERY_NS) % len(SHARES)]
        self.losses.append((t_ns, name))
        return [Disturbance(until_t_ns=t_ns + LASTS_NS, thrust_scale=scale)]


class Watcher:
    """What the figures are made of."""

    def __init__(self) -> None:
        self.alarms: list[int] = []
        self._alarm = False
        self._times: list[int] = []
        self._true: list[Triple] = []
        self._reports: list[tuple[int, Triple]] = []

    def stepped(self, *_: object) -> None:
        """Not looked at."""

    def published(self, _node: str, message: Arrival) -> None:
        """One message."""
        match message.signal:
            case ModelCheck() as check:
                if check.alarm and not self._alarm:
                    self.alarms.append(message.received_t_ns)
                self._alarm = check.alarm
            case Truth() as truth:
                self._times.append(truth.t_ns)
                self._true.append(truth.thrust_N)
            case Applied() as applied:
                self._reports.append((applied.t_ns, applied.thrust_N))
            case _:
                pass

    def missing(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Times (K,), |reported| summed over both lateral thrusters (K,), and N s missing up to then (K,)."""
        t = np.array(self._times)
        at, reported = np.array([x for x, _ in self._reports]), np.array([x for _, x in self._reports])
        both = np.stack([np.interp(t, at, reported[:, i]) for i in range(2)], axis=1)
        lacks = np.abs(both - np.array(self._true)[:, :2]).sum(axis=1)
        cost = np.concatenate([[0.0], np.cumsum(0.5e-9 * (lacks[1:] + lacks[:-1]) * np.diff(t))])
        return t, np.abs(both).sum(axis=1), cost


def fly(settings: tuple[str, ...], breaker: Breaker | None) -> Watcher:
    """One run in lock step."""
    here = resolve("descent", [Override("benchmark", settings)])
    table: list[Node] = nodes(here)
    if breaker is not None:
        table.insert(1, breaker)
    watcher = Watcher()
    lockstep = LockStep(table, start_ns=here.scenario.start_ns, observe=watcher, latest=LATEST)
    lockstep.advance(here.scenario.end_ns)
    return watcher


def of_run(state: str, breaker: Breaker, seen: Watcher, period_ns: int) -> Iterator[Loss]:
    """Each loss of a run."""
    t, thrust, cost = seen.missing()
    for begun, name in breaker.losses:
        alarm = next((a for a in seen.alarms if begun < a <= begun + LASTS_NS), None)
        until = begun + LASTS_NS if alarm is None else alarm
        held = (t > begun) & (t <= until)
        if not held.any():
            continue
        since = float(np.interp(begun, t, cost))
        mean = float(thrust[held].mean())
        if alarm is None:
            yield Loss(state, name, begun * 1e-9, mean, None, None, None)
        else:
            at, before = (float(np.interp(x, t, cost)) - since for x in (alarm, max(alarm - period_ns, begun)))
            yield Loss(state, name, begun * 1e-9, mean, (alarm - begun) * 1e-9, at, before)


def settings_of(seed: int, duration_s: float, *, known: bool) -> tuple[str, ...]:
    """What all runs have."""
    state = "true" if known else "false"
    return f"run.seed={seed}", f"run.duration_s={duration_s}", f"run.perfect_state={state}"


def mismatch(seed: int) -> tuple[str, ...]:
    """At the edge, or drawn."""
    if seed % 2:
        return EDGE
    drawn = np.random.default_rng(seed).uniform(0.9, 1.1, 3)
    return tuple(f"plant.mismatch.{name}={x:.4f}" for name, x in zip(("thrust", "drag", "mass"), drawn, strict=True))


def said(losses: list[Loss]) -> Iterator[str]:
    """A table: by state and kind, then by thrust."""
    yield (
        "| loss of 30 % | losses | no alarm | delay, median (s) | cost at the alarm, median, p90 (N s) | "
        "over 10 N s at the cycle before |"
    )
    yield "|---|---|---|---|---|---|"
    rows = {
        f"{state}, {name}": [x for x in losses if (x.state, x.of) == (state, name)]
        for state in ("known", "estimated")
        for name, _ in SHARES
    }
    for low, high in ((0, 10), (10, 20), (20, 40), (40, 80), (80, 125)):
        rows[f"{low} to {high} N"] = [x for x in losses if low <= x.thrust_N < high]
    for title, some in rows.items():
        heard = [loss for loss in some if loss.delay_s is not None]
        if not heard:
            yield f"| {title} | {len(some)} | {len(some)} | | | |"
            continue
        delay, cost, before = (np.array([getattr(x, f) for x in heard]) for f in ("delay_s", "cost_Ns", "before_Ns"))
        yield (
            f"| {title} | {len(some)} | {len(some) - len(heard)} | {np.median(delay):.2f} | "
            f"{np.median(cost):.1f}, {np.quantile(cost, 0.9):.1f} | {int((before > BOUND).sum())} |"
        )


def main() -> None:
    """Run, print, and keep where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nominal", type=int, default=100)
    parser.add_argument("--losses", type=int, default=20)
    parser.add_argument("--duration-s", type=float, default=200.0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    losses: list[Loss] = []
    false_alarms: list[tuple[int, float]] = []

    def keep(done: int) -> None:
        if options.out is not None:
            kept = {"nominal_runs": done, "false_alarms": false_alarms, "losses": [x._asdict() for x in losses]}
            options.out.write_text(json.dumps(kept, indent=1) + "\n")

    for k in range(options.losses):
        known = k % 2 == 0
        breaker = Breaker(k // 2)
        seen = fly(settings_of(FIRST_SEED + k // 2, options.duration_s, known=known), breaker)
        losses += of_run("known" if known else "estimated", breaker, seen, 300_000_000)
        false_alarms += [
            (FIRST_SEED + k // 2, a * 1e-9) for a in seen.alarms if (a - FIRST_NS) % EVERY_NS > LASTS_NS or a < FIRST_NS
        ]
        print(f"losses {k + 1}/{options.losses}", file=sys.stderr)
        keep(0)
    print("\n".join(said(losses)))
    for k in range(options.nominal):
        seed = FIRST_SEED + k // 2
        seen = fly((*settings_of(seed, options.duration_s, known=k % 2 == 0), *mismatch(k // 2)), None)
        false_alarms += [(seed, a * 1e-9) for a in seen.alarms]
        print(f"nominal {k + 1}/{options.nominal}, {len(false_alarms)} false alarms", file=sys.stderr)
        keep(k + 1)
    print(
        f"\n{len(false_alarms)} false alarms, in {options.nominal} runs with mismatch and beside {len(losses)} losses"
    )


if __name__ == "__main__":
    main()
