"""Compare the time of a control cycle with that of another version of the code, interleaved.

    .venv/bin/python -m benchmarks.versions TREE [--solvers osqp,riccati] [--horizons 5.1,13.8] [--flushed]

TREE is a checkout of the other version (``git worktree add TREE COMMIT``). One process of each version holds its loops:
the paper's vehicle descends in a known current. They take turns in bursts of cycles, so that both see the same load of
the machine. A burst counts with its median; the ratio is the median over all pairs of bursts. ``--flushed`` overwrites
the processor's caches before each cycle.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import msgspec
import numpy as np

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Vehicle, advance, references

BURSTS, CYCLES = 24, 40
FLUSH_BYTES = 64 << 20
PAPER = Vehicle.load("paper")


class Loop:
    """Descent of the nominal model with one solver and horizon."""

    def __init__(self, solver: str, horizon_s: float) -> None:
        config = ControllerConfig(solver=solver, horizon_s=horizon_s, sqp_iterations=1)
        self._controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0, depth_m=1000.0), config)
        z = np.arange(0.0, 1000.0, 2.0)
        rng = np.random.default_rng(0)
        water = CurrentProfile(depth_m=z, north_mps=rng.normal(0, 0.04, len(z)), east_mps=rng.normal(0, 0.04, len(z)))
        self._estimate = msgspec.structs.replace(Estimate.at_rest(depth_m=0.0), current=water)

    def burst(self, cycles: int, room: np.ndarray | None) -> list[float]:
        """Return the times of cycles (us)."""
        times = []
        for _ in range(cycles):
            if room is not None:
                room += 1
            started = time.perf_counter()
            plan = self._controller.plan(self._estimate)
            times.append((time.perf_counter() - started) * 1e6)
            self._estimate = advance(PAPER, self._estimate, plan, duration_s=0.3)
        return times


def serve() -> None:
    """Run the bursts that the parent asks for, one line of JSON each."""
    loops: dict[str, Loop] = {}
    room = np.zeros(FLUSH_BYTES, dtype=np.uint8)
    for line in sys.stdin:
        solver, horizon_s, flushed = json.loads(line)
        loop = loops.setdefault(line, Loop(solver, horizon_s))
        print(json.dumps(loop.burst(CYCLES, room if flushed else None)), flush=True)


def start(tree: Path) -> subprocess.Popen[str]:
    """Return a process of one version."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-P", str(Path(__file__).resolve()), "--serve", "."]
    return subprocess.Popen(
        command, cwd=tree, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )


def ask(process: subprocess.Popen[str], *question: object) -> float:
    """Return the median of one burst (us)."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps(question) + "\n")
    process.stdin.flush()
    return float(np.median(json.loads(process.stdout.readline())))


def main() -> None:
    """Print a line for each solver and horizon."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tree", type=Path, help="checkout of the other version")
    parser.add_argument("--solvers", default="osqp,riccati")
    parser.add_argument("--horizons", default="5.1,13.8", help="seconds")
    parser.add_argument("--flushed", action="store_true", help="overwrite the caches before each cycle")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve()
        return
    here, other = start(Path(__file__).resolve().parents[1]), start(options.tree.resolve())
    for solver in options.solvers.split(","):
        for horizon_s in map(float, options.horizons.split(",")):
            question = solver, horizon_s, options.flushed
            for process in (here, other):
                ask(process, *question)  # compiles, and begins the descent
            pairs = np.array([(ask(here, *question), ask(other, *question)) for _ in range(BURSTS)])
            low, ratio, high = np.quantile(pairs[:, 0] / pairs[:, 1], [0.25, 0.5, 0.75])
            ours, theirs = np.median(pairs, axis=0)
            print(
                f"{solver} {horizon_s:g} s: {ours:.0f} us, other version {theirs:.0f} us, "
                f"ratio {ratio:.2f} ({low:.2f} to {high:.2f})"
            )
    for process in (here, other):
        process.terminate()


if __name__ == "__main__":
    main()
