"""Soak test: growth of memory, file handles and threads of each process in a long run, and misses by quarter.

    .venv/bin/python -m benchmarks.soak [--minutes 60] [--speed 10] [--every-s 10] [--out DIR]

`hover` by `ltv-mpc sim` is observed through /proc and ended by Ctrl-C after the given wall time. Memory is what a
process has written; memory that several forks share is divided among them (Pss_Anon of smaps_rollup). Pages of files,
as of libraries, are not included: other programs share them, so their size depends on these programs.

    growth   of a process: median of its last quarter minus that of its second one; the first is warm-up
    misses   from the run's recording: cycles whose plan was not solved, late plans, messages missing by their
             sequence numbers; in each quarter of the vehicle's time

Exit 1 where memory grew by more than 2 MB and 2 % of it (the recorder: by what the index of its chunks takes on top,
30 MB an hour; the supervisor: by the tracks of the summary, 20 MB an hour of the vehicle), a process has more handles
or threads in its last quarter than ever in its second, or a last quarter missed more than
twice what the second and third did, and more than five.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.processes import descendants
from ltv_mpc.messages import Applied, Array, Plan, PlanOrigin
from services.recording.loss_accounting import LossAccounting
from services.recording.reader import Recording

MOST_GROWTH_MB, MOST_GROWTH = 2.0, 0.02
INDEX_MB_PER_HOUR, TRACKS_MB_PER_HOUR = 30.0, 20.0
"""Growth of the recorder: mcap's writer keeps an entry for each chunk until the end (docs/notes/libraries.md). Growth
of the supervisor in an hour of the vehicle: positions and commands, of which the summary is made.
"""
FEW = 5
QUARTERS = 4
RECORDER, SUPERVISOR = "ltv-recorder", "supervisor"


class Look(NamedTuple):
    """One process at one moment."""

    at_s: float
    memory_mb: float
    handles: int
    threads: int


def look(pid: int, at_s: float) -> Look | None:
    """Return a sample of a process, or None if it has just ended."""
    folder = Path("/proc", str(pid))
    try:
        rollup = (folder / "smaps_rollup").read_text(encoding="utf-8")
        (pss,) = (line.split()[1] for line in rollup.splitlines() if line.startswith("Pss_Anon:"))
        return Look(at_s, int(pss) / 1024, len(os.listdir(folder / "fd")), len(os.listdir(folder / "task")))
    except (OSError, ValueError):
        return None


def watch(supervisor: subprocess.Popen[bytes], wall_s: float, every_s: float) -> dict[str, list[Look]]:
    """Return all samples by process; a restarted process counts as another one."""
    looks: dict[int, list[Look]] = {}
    names: dict[int, str] = {}  # a fork has its own name a moment later
    began = time.monotonic()
    while (at_s := time.monotonic() - began) < wall_s and supervisor.poll() is None:
        for pid, name in descendants(supervisor.pid).items():
            if (seen := look(pid, at_s)) is not None:
                names[pid] = name
                looks.setdefault(pid, []).append(seen)
        sys.stderr.write(f"\r{at_s / 60:.1f} of {wall_s / 60:g} min")
        time.sleep(every_s)
    sys.stderr.write("\n")
    return {f"{name} {pid}": looks[pid] for pid, name in names.items()}


def is_flat(process: str, looks: Sequence[Look], wall_s: float, speed: float) -> bool:
    """Print the figures of a process by quarters of the run; return False if it has grown."""
    quarters = [[one for one in looks if int(QUARTERS * one.at_s / wall_s) == k] for k in range(QUARTERS)]
    memory = [float(np.median([one.memory_mb for one in of])) if of else float("nan") for of in quarters]
    handles, threads = ([max((one[i] for one in of), default=0) for of in quarters] for i in (2, 3))
    allowed_mb = max(MOST_GROWTH_MB, MOST_GROWTH * memory[1])
    per_hour = {RECORDER: INDEX_MB_PER_HOUR, SUPERVISOR: TRACKS_MB_PER_HOUR * speed}
    # Medians of two quarters that lie half a run apart.
    allowed_mb += per_hour.get(process.partition(" ")[0], 0.0) * wall_s / 3600.0 / 2
    lasting = all(quarters[1:])  # else it was started or ended in between
    grew = memory[-1] - memory[1] > allowed_mb or handles[-1] > handles[1] or threads[-1] > threads[1]
    flat = not (lasting and grew)
    cells = " ".join(f"{value:8.1f}" for value in memory)
    print(f"{process:<26}{cells:>36} {handles!s:>20} {threads!s:>20}", "" if flat else "grew")
    return flat


def missed(recording: Path) -> Mapping[str, Array]:
    """Return how often something was missed, by quarters of the recording (4,), and the cycles."""
    times: dict[str, list[int]] = {"cycles": [], "not solved": [], "plans late": [], "messages missing": []}
    losses, before = LossAccounting(), {"plans late": 0, "messages missing": 0}
    for message in Recording(recording):
        losses.add(message.key, message.plain["epoch"], message.plain["sequence"])
        if message.kind is Plan and message.plain["cycle_t_ns"] >= 0:
            times["cycles"].append(message.t_ns)
            times["not solved"] += [message.t_ns] * (message.plain["origin"] != PlanOrigin.SOLVED)
        elif message.kind is Applied:
            counts = {"plans late": int(message.plain["plans_late"]), "messages missing": losses.missing}
            for name, count in counts.items():
                times[name] += [message.t_ns] * (count - before[name])
            before = counts
    every = times["cycles"] or [0]
    return {name: np.histogram(of, QUARTERS, (every[0], every[-1] + 1))[0] for name, of in times.items()}


def main() -> int:
    """Run the soak test and report what grew."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of wall time")
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--every-s", type=float, default=10.0)
    parser.add_argument("--out", type=Path, help="keep the run here")
    of = parser.parse_args()
    wall_s = 60.0 * of.minutes
    with tempfile.TemporaryDirectory() as place, Path(place, "said").open("w+b") as said:
        out = of.out or Path(place, "run")
        options = ["--duration-s", f"{2 * of.speed * wall_s:g}", "--speed", f"{of.speed:g}", "--no-dashboard"]
        command = [sys.executable, "-P", "-m", "services.cli", "sim", "hover", *options, "--out", str(out)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said) as process:
            looks = watch(process, wall_s, of.every_s)
            code = process.poll()
            if code is None:
                process.send_signal(signal.SIGINT)
        if code is not None:
            said.seek(0)
            sys.stderr.write(f"the run ended before its time, with exit code {code}:\n{said.read().decode()}")
            return 1
        quarters = missed(out / "run.mcap")
    print(f"{'process':<26}{'MB, median by quarter':>36} {'handles':>20} {'threads':>20}")
    flat = {is_flat(name, seen, wall_s, of.speed) for name, seen in looks.items()} == {True}  # prints all
    for name, counts in quarters.items():
        print(f"{name:<26}{' '.join(f'{count:8d}' for count in counts):>36}")
    of_all = sum(counts for name, counts in quarters.items() if name != "cycles")
    good = flat and quarters["cycles"].any() and of_all[-1] <= max(FEW, 2 * of_all[1:-1].max())
    print("flat" if good else "not flat")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
