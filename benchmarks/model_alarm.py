"""Delay and false alarms of the model check.

    .venv/bin/python -m benchmarks.model_alarm [--nominal N] [--losses N] [--duration-s S] [--first-seed N]
                                               [--sensors paper|realistic] [--out FILE.json]
                                               [--without-current] [--picture FILE.png]

FILE.json is written after every run; the same command continues an interrupted benchmark.

Nominal: descents in lock step with mass, drag and thrust off by 10 % at most: in every second run each of the three
is random from -10 % to 10 %, in the others all are at the edge that resembles a loss most (thrust 0.9, drag and mass
1.1). The state is known in half of them, estimated in the other half. Every alarm is false.

Losses: every 30 s port, starboard or both deliver 30 % less than they report, for 8 s. The cost of a loss is the
impulse that is missing since, the integral of what was reported less what was delivered; the table has it at the alarm,
beside the delay, by the thrust at the time. Seeds from 5000 up: those from 1000 to 1100 were looked at while threshold
and noise were chosen, losses of 5000 to 5011 when thrusters of one make and what was before a window came in.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from matplotlib.figure import Figure

from benchmarks import sheet
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Applied, Disturbance, Estimate, Message, ModelCheck, Triple, Truth
from ltv_mpc.node import Grid, Inbox, Node, ReceivedMessage
from services.reporting.plots import palette
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from services.tools.lockstep_run import LATEST
from sim.scheduler import LockStep, Observation

S = 1_000_000_000
EVERY_NS, LASTS_NS, FIRST_NS = 30 * S, 8 * S, 6 * S
SHARES: tuple[tuple[str, Triple], ...] = (
    ("both", (0.7, 0.7, 1.0)),
    ("port", (0.7, 1.0, 1.0)),
    ("starboard", (1.0, 0.7, 1.0)),
)
COLOURS = (palette.OTHER, palette.PORT, palette.STARBOARD)
"""Of both thrusters, port and starboard, as in ``SHARES``."""

FIRST_SEED = 5000
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
    reads: tuple[type[Message], ...] = ()
    writes: tuple[type[Message], ...] = (Disturbance,)

    def __init__(self, first: int) -> None:
        """Take the index of the first of ``SHARES``."""
        self.losses: list[tuple[int, str]] = []
        self._first = first

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        """Apply the thrust loss at its time."""
        since_ns = t_ns - FIRST_NS
        if since_ns < 0 or since_ns % EVERY_NS:
            return []
        name, scale = SHARES[(self._first + since_ns // EVERY_NS) % len(SHARES)]
        self.losses.append((t_ns, name))
        return [Disturbance(end_t_ns=t_ns + LASTS_NS, thrust_scale=scale)]


class Watcher:
    """Observer that collects alarms and true motion for the figures."""

    def __init__(self) -> None:
        self.alarms: list[int] = []
        self.evidence = 0.0  # the largest, nats
        self._alarm = False
        self._times: list[int] = []
        self._true: list[Triple] = []
        self._reports: list[tuple[int, Triple]] = []

    def published(self, _node: str, message: ReceivedMessage) -> None:
        """Handle one message."""
        match message.message:
            case ModelCheck() as check:
                if check.alarm and not self._alarm:
                    self.alarms.append(message.received_t_ns)
                self._alarm = check.alarm
                self.evidence = max(self.evidence, check.evidence)
            case Truth() as truth:
                self._times.append(truth.t_ns)
                self._true.append(truth.thrust_N)
            case Applied() as applied:
                self._reports.append((applied.t_ns, applied.thrust_N))
            case _:
                pass

    def missing(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return times (K,), the sum of abs(reported) over both lateral thrusters (K,), and the impulse lost by then
        (K,) (N s).
        """
        t = np.array(self._times)
        at, reported = np.array([x for x, _ in self._reports]), np.array([x for _, x in self._reports])
        both = np.stack([np.interp(t, at, reported[:, i]) for i in range(2)], axis=1)
        lacks = np.abs(both - np.array(self._true)[:, :2]).sum(axis=1)
        cost = np.concatenate([[0.0], np.cumsum(0.5e-9 * (lacks[1:] + lacks[:-1]) * np.diff(t))])
        return t, np.abs(both).sum(axis=1), cost


def withhold_current(node: ControllerNode) -> None:
    """Let the controller receive estimates without a current."""
    receive = node.receive

    def without(received: ReceivedMessage) -> None:
        message = received.message
        if isinstance(message, Estimate):
            received = msgspec.structs.replace(received, message=msgspec.structs.replace(message, current=None))
        receive(received)

    node.receive = without  # type: ignore[method-assign]


def fly(settings: tuple[str, ...], breaker: Breaker | None, *, with_current: bool = True) -> Watcher:
    """One run in lock step."""
    here = resolve("descent", [Override("benchmark", settings)])
    table: list[Node] = make_nodes(here)
    if not with_current:
        for node in table:
            if isinstance(node, ControllerNode):
                withhold_current(node)
    if breaker is not None:
        table.insert(1, breaker)
    watcher = Watcher()
    lockstep = LockStep(table, start_ns=here.scenario.start_ns, observation=Observation(watcher), latest=LATEST)
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


def settings_of(seed: int, of: Kept, *, known: bool) -> tuple[str, ...]:
    """Return the settings that all runs share."""
    state = "true" if known else "false"
    run = f"run.seed={seed}", f"run.duration_s={of.duration_s}", f"run.perfect_state={state}"
    return *run, f"sensors={of.sensors}"


def mismatch(seed: int) -> tuple[str, ...]:
    """Return a mismatch at the edge of the bounds (odd seeds) or a random one."""
    if seed % 2:
        return EDGE
    drawn = np.random.default_rng(seed).uniform(0.9, 1.1, 3)
    return tuple(f"plant.mismatch.{name}={x:.4f}" for name, x in zip(("thrust", "drag", "mass"), drawn, strict=True))


def said(losses: list[Loss]) -> Iterator[str]:
    """Format a table: by state and kind, then by thrust."""
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


class Kept(msgspec.Struct, kw_only=True):
    """Results so far, as stored in FILE.json."""

    duration_s: float
    first_seed: int
    sensors: str
    with_current: bool = True
    loss_runs: int = 0
    nominal_runs: int = 0
    false_alarms: list[tuple[int, float]] = []
    """Seed and time (s)."""
    losses: list[Loss] = []
    evidence: list[float] = []
    """The largest of each nominal run (nats): what ``ALARM_NATS`` has to be above."""


def opened(path: Path | None, asked: Kept) -> Kept:
    """Read the results in ``path`` of the runs that are ``asked`` for; none if there is no file yet."""
    if path is None or not path.exists():
        return asked
    found = msgspec.json.decode(path.read_bytes(), type=Kept)
    for name in ("duration_s", "first_seed", "sensors", "with_current"):
        if getattr(found, name) != getattr(asked, name):
            raise SystemExit(f"{path} holds other runs: {name} = {getattr(found, name)}")
    return found


def picture(losses: list[Loss], path: Path) -> None:
    """Draw the delay of the alarm against the thrust at the time, with the lines of equal cost."""
    heard = [loss for loss in losses if loss.delay_s is not None]
    with sheet.style(page=True):
        figure = Figure(figsize=(sheet.PAGE_IN, 4.5), layout="constrained")
        axes = figure.subplots()
        for state, face in (("known", None), ("estimated", "none")):
            for (name, _), mark, colour in zip(SHARES, "o<>", COLOURS, strict=True):
                some = [loss for loss in heard if (loss.state, loss.of) == (state, name)]
                x, y = [loss.thrust_N for loss in some], [loss.delay_s or 0.0 for loss in some]
                axes.plot(x, y, mark, color=colour, mfc=face or colour, markersize=5, label=f"{name}, state {state}")
        missed = [loss.thrust_N for loss in losses if loss.delay_s is None]
        late = f"none within {LASTS_NS // S} s"
        axes.plot(missed, [LASTS_NS / S] * len(missed), "x", color=palette.LIMIT, markersize=6, label=late)
        largest = 10.0 * np.ceil(0.1 * max(loss.thrust_N for loss in losses))
        thrust = np.linspace(4.0, largest, 200)
        for share, text, dash in ((0.3, "both", "--"), (0.15, "one of two", ":")):
            label = f"{BOUND:g} N s lost, {text}"
            axes.plot(thrust, BOUND / (share * thrust), dash, color=palette.REFERENCE, label=label)
        axes.set(xlabel="|port| + |starboard| until the alarm (N)", ylabel="delay (s)")
        axes.set(ylim=(0.0, 8.5), xlim=(0.0, largest))
        sheet.legend_above(axes, "Delay of the alarm after a loss of 30 % of the thrust")
        sheet.write(figure, [path])


def main() -> None:
    """Run, print, and keep where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nominal", type=int, default=100)
    parser.add_argument("--losses", type=int, default=20)
    parser.add_argument("--duration-s", type=float, default=200.0)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--sensors", choices=("paper", "realistic"), default="paper")
    parser.add_argument("--without-current", action="store_true", help="withhold the current from the controller")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    kept = opened(
        options.out,
        Kept(
            duration_s=options.duration_s,
            first_seed=options.first_seed,
            sensors=options.sensors,
            with_current=not options.without_current,
        ),
    )

    def keep(text: str) -> None:
        print(text, file=sys.stderr)
        if options.out is not None:
            draft = options.out.with_suffix(".part")
            draft.write_bytes(msgspec.json.format(msgspec.json.encode(kept), indent=1) + b"\n")
            draft.replace(options.out)

    for k in range(kept.loss_runs, options.losses):
        known, seed = k % 2 == 0, options.first_seed + k // 2
        breaker = Breaker(k // 2)
        seen = fly(settings_of(seed, kept, known=known), breaker, with_current=kept.with_current)
        kept.losses += of_run("known" if known else "estimated", breaker, seen, 300_000_000)
        kept.false_alarms += [
            (seed, a * 1e-9) for a in seen.alarms if (a - FIRST_NS) % EVERY_NS > LASTS_NS or a < FIRST_NS
        ]
        kept.loss_runs = k + 1
        keep(f"losses {k + 1}/{options.losses}")
    for k in range(kept.nominal_runs, options.nominal):
        seed = options.first_seed + k // 2
        settings = (*settings_of(seed, kept, known=k % 2 == 0), *mismatch(k // 2))
        seen = fly(settings, None, with_current=kept.with_current)
        kept.false_alarms += [(seed, a * 1e-9) for a in seen.alarms]
        kept.evidence.append(seen.evidence)
        kept.nominal_runs = k + 1
        keep(f"nominal {k + 1}/{options.nominal}, {len(kept.false_alarms)} false alarms")
    print("\n".join(said(kept.losses)))
    print(
        f"\n{len(kept.false_alarms)} false alarms, in {kept.nominal_runs} runs with mismatch and beside "
        f"{len(kept.losses)} losses"
    )
    if kept.evidence:
        at = np.quantile(kept.evidence, (0.5, 0.9, 1.0))
        print(f"largest evidence of a run with mismatch: median {at[0]:.1f}, 90 % {at[1]:.1f}, all {at[2]:.1f} nats")
    if options.picture is not None:
        picture(kept.losses, options.picture)


if __name__ == "__main__":
    main()
