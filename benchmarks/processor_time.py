"""Processor time of `make sim` by process, also against another checkout of the project.

    .venv/bin/python -m benchmarks.processor_time [--against FOLDER] [--turns N] [--duration-s T] [--speed X]

Times are user and system time of all threads, so they hold on a busy machine as well. They cover the whole command,
from its start to its report. With ``--against`` both versions run interleaved, in alternating order; the interval
(95 %) of the ratio is bootstrapped over the turns. The share of a core is measured while the clock runs, from
``SETTLED_S`` after the plant's start to its end. A recording must have every message: a lost one ends the measurement.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from benchmarks import processes
from benchmarks.processes import descendants

ROOT = Path(__file__).resolve().parents[1]
SURFACE_S = 10.0
"""Time at the surface before the descent of ``--duration-s``."""
SAMPLE_S = 0.25
SETTLED_S = 2.0
ABOARD = ("router", "estimator", "controller", "recorder")
"""Processes that a vehicle has, too."""
RESAMPLED = 4000

Times: TypeAlias = dict[str, tuple[float, float]]
"""User and system time (s) by process name."""


class Run(NamedTuple):
    """Figures of one run."""

    times: Times
    share: dict[str, float]  # of a core, by process, while the clock runs

    @property
    def total_s(self) -> float:
        """Processor time of all processes."""
        return sum(map(sum, self.times.values()))


def measure(checkout: Path, out: Path, *, duration_s: float, speed: float) -> Run:
    """Run the command in a checkout once, and sample its processes until it ends."""
    command = [sys.executable, "-P", "-m", "services.cli", "sim", "--dashboard", "--seed", "7", "--speed", f"{speed:g}"]
    command += ["--duration-s", f"{duration_s:g}", "--surface-time-s", f"{SURFACE_S:g}", "--json", "--out", str(out)]
    newest: dict[int, processes.Times] = {}
    samples: list[tuple[float, Times]] = []
    with (
        tempfile.TemporaryFile("w+") as console,
        subprocess.Popen(
            command,
            cwd=checkout,
            env={**os.environ, "PYTHONPATH": str(checkout)},
            stdout=subprocess.PIPE,
            stderr=console,
        ) as process,
    ):
        while process.poll() is None:
            newest.update(now := descendants(process.pid))
            if any(one.name == "ltv-plant" for one in now.values()):
                samples.append((time.monotonic(), by_name(now)))
            time.sleep(SAMPLE_S)
        assert process.stdout is not None
        output = process.stdout.read()
        if process.returncode != 0:
            console.seek(0)
            sys.exit(f"{' '.join(command)}: exit code {process.returncode}\n{console.read()}")
    if dropped := json.loads(output)["messages"]["dropped"]:
        sys.exit(f"{out}: {dropped} messages are not recorded")
    (start_s, start), (end_s, end) = next(s for s in samples if s[0] > samples[0][0] + SETTLED_S), samples[-1]
    share = {name: (sum(end[name]) - sum(start.get(name, (0.0, 0.0)))) / (end_s - start_s) for name in end}
    return Run(by_name(newest), share)


def by_name(rows: dict[int, processes.Times]) -> Times:
    """Return the sums of the times of processes of one name."""
    times: dict[str, tuple[float, float]] = defaultdict(lambda: (0.0, 0.0))
    for name, user_s, system_s in rows.values():
        user, system = times[name.removeprefix("ltv-")]
        times[name.removeprefix("ltv-")] = user + user_s, system + system_s
    return dict(times)


def ratio(ours: list[Run], theirs: list[Run]) -> str:
    """Format the ratio of the total times, with its interval."""
    rng = np.random.default_rng(0)
    a, b = (np.array([run.total_s for run in runs]) for runs in (ours, theirs))
    drawn = rng.integers(len(a), size=(RESAMPLED, len(a)))
    low, high = np.percentile(a[drawn].sum(axis=1) / b[drawn].sum(axis=1), (2.5, 97.5))
    return f"ratio of the processor times {a.sum() / b.sum():.3f} ({low:.3f} to {high:.3f}), {len(a)} turns"


def table(title: str, runs: list[Run], vehicle_s: float) -> str:
    """Format the means of the runs by process, and their sums."""
    names = sorted({name for run in runs for name in run.times})
    rows: dict[str, tuple[float, float, float]] = {}
    for name in names:
        user_s, system_s = (statistics.fmean(run.times.get(name, (0.0, 0.0))[i] for run in runs) for i in (0, 1))
        share = statistics.fmean(run.share.get(name, 0.0) for run in runs)
        rows[name] = user_s, system_s, share
    for name, among in (("all", names), ("aboard", ABOARD)):
        user_s, system_s, share = (sum(rows[each][i] for each in among) for i in range(3))
        rows[name] = user_s, system_s, share
    lines = [f"{title}: {vehicle_s:g} s, no message lost", ""]
    lines += ["| process | user (s) | system (s) | each vehicle second (ms) | of a core (%) |", "|---|" + "---:|" * 4]
    for name, (user_s, system_s, share) in rows.items():
        each_ms = 1000 * (user_s + system_s) / vehicle_s
        lines.append(f"| {name} | {user_s:.2f} | {system_s:.2f} | {each_ms:.1f} | {100 * share:.1f} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Run the turns and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="checkout to compare with")
    parser.add_argument("--turns", type=int, default=1)
    parser.add_argument("--duration-s", type=float, default=200.0)
    parser.add_argument("--speed", type=float, default=10.0)
    options = parser.parse_args()
    checkouts = [ROOT] if options.against is None else [ROOT, options.against.resolve()]
    runs: dict[Path, list[Run]] = {checkout: [] for checkout in checkouts}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(options.turns):
            for checkout in checkouts if turn % 2 == 0 else checkouts[::-1]:
                out = Path(folder) / f"{turn}-{checkouts.index(checkout)}"
                run = measure(checkout, out, duration_s=options.duration_s, speed=options.speed)
                runs[checkout].append(run)
                print(f"turn {turn + 1}: {run.total_s:.2f} s  {checkout}", file=sys.stderr, flush=True)
    for title, found in zip(("this version", "other version"), runs.values(), strict=False):
        print(table(title, found, SURFACE_S + options.duration_s))
    if len(checkouts) == 2:
        print(ratio(*runs.values()))


if __name__ == "__main__":
    main()
