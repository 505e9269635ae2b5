"""Measure and write the table: see the package's head."""

from __future__ import annotations

import argparse
import random
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.progress import Progress

from benchmarks.peers import known
from benchmarks.peers.loop import Held, candidate_of, closed
from services.tools.profile import machine_description, problems
from services.tools.profile.measure import Candidate, measure, solver_by_name
from services.tools.profile.problems import Episode, seconds
from services.tools.profile.run import WARM_UP, Spread

OURS: dict[Candidate, str] = {
    solver_by_name("osqp"): "this project: OSQP, sparse",
    solver_by_name("riccati"): "this project: Riccati sweeps",
    solver_by_name("piqp"): "PIQP by qpsolvers",
}

PACKAGES = (
    *("numpy", "scipy", "numba", "osqp", "daqp", "piqp", "qpsolvers", "qpmpc", "do-mpc", "casadi"),
    "comma-deps-acados",
)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stages", type=int, default=17)
    parser.add_argument("--cycles", type=int, default=400)
    parser.add_argument("--seeds", type=int, default=2, help="of the closed loops")
    options = parser.parse_args()
    print(compare(options.stages, options.cycles, options.seeds, Console(stderr=True)))


def compare(stages: int, cycles: int, seeds: int, console: Console) -> str:
    """Return the comparison of all tools that are installed, in Markdown."""
    episodes = problems.simulated(stages, cycles, 0)
    loops = [episode for seed in range(seeds) for episode in problems.simulated(stages, cycles, 1000 * seed)]
    peers, missing = known.installed()
    for file in missing:
        console.print(f"not installed: what benchmarks/peers/{file}.py needs (extra bench)")
    peer_of = {candidate_of(peer): peer for peer in peers}
    who = OURS | {candidate: candidate.name for candidate in peer_of}
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
        held: dict[Candidate, list[Held]] = {}
        for candidate in who:
            held[candidate] = [closed(candidate, episode) for episode in loops]
            progress.advance(task, len(loops))
    kinds = ", ".join(dict.fromkeys(episode.kind for episode in loops))
    lines = [
        f"# A control step of {stages} stages ({seconds(stages):.1f} s) beside other tools",
        "",
        f"| | solves | median (ms) | p99 (ms) | first thrust off, p99 (N) | {kinds}: off (m) | unsolved | settings |",
        "|" + "---|" * 8,
    ]
    for (candidate, name), sample in zip(who.items(), samples, strict=True):
        solves, settings = ("QP", "defaults")
        if (peer := peer_of.get(candidate)) is not None:
            solves, settings = peer.solves, peer.settings
        cycle_us, thrust_N = Spread.of(sample.cycle_us), Spread.of(sample.thrust_error_N)
        lines.append(
            f"| {name} | {solves} | {cycle_us.median / 1e3:.3g} | {cycle_us.p99 / 1e3:.3g} "
            f"| {f'{thrust_N.p99:.2g}' if solves == 'QP' else ''} | {_off_m(loops, held[candidate])} "
            f"| {sum(one.unsolved for one in held[candidate])} | {settings} |"
        )
    machine = machine_description.machine(load, PACKAGES)
    measured = f"Measured on: {machine_description.line(machine, PACKAGES)}; commit {machine['commit']}."
    return "\n".join([*lines, "", f"{cycles} cycles for the times, {seeds} x {cycles} for the errors.", measured])


def _off_m(loops: Sequence[Episode], held: Sequence[Held]) -> str:
    """Return the mean distance from the line by kind of episode, weighted by their cycles."""
    kinds = dict.fromkeys(episode.kind for episode in loops)
    of_kind = [[i for i, episode in enumerate(loops) if episode.kind == kind] for kind in kinds]
    cycles = np.array([episode.cycles for episode in loops])
    off_m = np.array([one.off_m for one in held])
    return ", ".join(f"{np.average(off_m[those], weights=cycles[those]):.3f}" for those in of_kind)


if __name__ == "__main__":
    main()
