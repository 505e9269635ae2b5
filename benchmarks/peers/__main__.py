"""Measure and write the table: see the package's head."""

from __future__ import annotations

import argparse
import random
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.peers import known, table
from benchmarks.peers.loop import Entry, Held, closed
from services.tools.profile import machine_description, problems
from services.tools.profile.measure import Candidate, SolverByName, measure
from services.tools.profile.problems import Episode, seconds
from services.tools.profile.run import WARM_UP, YARDSTICK, Spread

OURS: dict[Candidate, str] = {
    SolverByName("osqp"): "this project: OSQP, sparse",
    SolverByName("riccati"): "this project: Riccati sweeps",
    YARDSTICK: "PIQP, sparse",
}

PACKAGES = ("numpy", "scipy", "numba", "osqp", "daqp", "piqp", "qpsolvers", "qpmpc", "do-mpc", "casadi", "cvxpy")

OUT = Path(__file__).resolve().parents[1] / "results" / "peers.md"

NOTES = (
    "Every tool is the solver of one and the same controller: prediction of the delay, guess, and the step along the",
    "exact flow are the same for all and are in the time. Times are of the same problems, those of a loop that the",
    "first line drives, solved by all in an order drawn anew in each cycle. Median and p99 are interleaved. Hot is the",
    "same cycle repeated at once; cold is after a flush of the caches, as in a service. Errors are of closed loops",
    "that each tool drives itself, with the state known. QP: the controller's own convex problem, whose exact solution",
    "the first thrust is compared with. NLP: the nonlinear problem behind it, to its own local optimum.",
)


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__)
    parser.add_argument("--stages", type=int, default=17)
    parser.add_argument("--cycles", type=int, default=400)
    parser.add_argument("--seeds", type=int, default=2, help="of the closed loops")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    text = compare(options.stages, options.cycles, options.seeds, Console(stderr=True))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(text, encoding="utf-8")
    print(text)


def compare(stages: int, cycles: int, seeds: int, console: Console) -> str:
    """Return the comparison of all tools that are installed."""
    episodes = problems.simulated(stages, cycles, 0)
    loops = [episode for seed in range(seeds) for episode in problems.simulated(stages, cycles, 1000 * seed)]
    peers, missing = known.installed()
    for file in missing:
        console.print(f"not installed: what benchmarks/peers/{file}.py needs (extra bench)")
    who = OURS | {Entry(peer): peer.name for peer in peers}
    load = machine_description.load()
    with Progress(console=console) as progress:
        task = progress.add_task("time, on the same problems", total=cycles)
        samples = measure(
            episodes,
            list(who),
            warm_up=episodes[0]._replace(cycles=WARM_UP),
            order=random.Random(0),
            progress=lambda: progress.advance(task),
        )
        task = progress.add_task("closed loops", total=len(who) * len(loops))
        held = {}
        for candidate in who:
            outcomes = []
            for episode in loops:
                outcomes.append((episode, closed(candidate, episode)))
                progress.advance(task)
            held[candidate] = _by_kind(outcomes)
    lines = [
        table.Line(
            name=name,
            solves=candidate.peer.solves if isinstance(candidate, Entry) else "QP",
            settings=candidate.peer.settings if isinstance(candidate, Entry) else "defaults",
            cycle_us=Spread.of(sample.cycle_us),
            repeated_us=Spread.of(sample.repeated_us),
            flushed_us=Spread.of(sample.flushed_us),
            thrust_error_N=Spread.of(sample.thrust_error_N),
            held=held[candidate],
        )
        for (candidate, name), sample in zip(who.items(), samples, strict=True)
    ]
    return table.markdown(
        lines,
        title=f"A control step of {stages} stages ({seconds(stages):.1f} s) beside other tools",
        notes=[*NOTES, f"{cycles} cycles for the times, {seeds} x {cycles} for the errors; `make bench`."],
        machine=machine_description.machine(load, PACKAGES),
        packages=PACKAGES,
    )


def _by_kind(outcomes: Sequence[tuple[Episode, Held]]) -> dict[str, Held]:
    """Return the means over the episodes of a kind, weighted by their cycles."""
    kinds = {}
    for kind in dict.fromkeys(episode.kind for episode, _ in outcomes):
        of_kind = [(episode.cycles, held) for episode, held in outcomes if episode.kind == kind]
        weights = [cycles for cycles, _ in of_kind]
        kinds[kind] = Held(
            off_m=float(np.average([held.off_m for _, held in of_kind], weights=weights)),
            thrust_N=float(np.average([held.thrust_N for _, held in of_kind], weights=weights)),
            unsolved=sum(held.unsolved for _, held in of_kind),
        )
    return kinds


if __name__ == "__main__":
    main()
