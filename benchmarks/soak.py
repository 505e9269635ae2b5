"""Soak test: growth of memory, file handles and threads of each process in a long run, and misses by quarter.

    .venv/bin/python -m benchmarks.soak [--minutes 60] [--speed 10] [--every-s 10] [--out DIR] [--json]

`hover` by `ltv-mpc sim` is observed through /proc and ended by Ctrl-C after the given wall time. Memory is what a
process has written; memory that several forks share is divided among them (Pss_Anon of smaps_rollup). Pages of files,
as of libraries, are not included: other programs share them, so their size depends on these programs.

    growth   of a process: median of its last quarter minus that of its second one; the first is warm-up
    misses   from the run's recording: cycles whose plan was not solved, late plans, messages missing by their
             sequence numbers; in each quarter of the vehicle's time

Exit 1 where memory grew by more than 2 MB and 2 % of it (the recorder: by what the index of its chunks takes on top,
30 MB an hour), a process has more handles or threads in its last quarter than ever in its second, or a last quarter
missed more than twice what the second and third did, and more than five.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.processes import children
from ltv_mpc.messages import Applied, Plan, PlanOrigin
from services.recording.loss_accounting import LossAccounting
from services.recording.reader import Recording

MOST_GROWTH_MB, MOST_GROWTH = 2.0, 0.02
INDEX_MB_PER_HOUR = 30.0
"""Growth of the recorder: mcap's writer keeps an entry for each chunk until the end (docs/notes/libraries.md)."""
FEW = 5
QUARTERS = 4
SUPERVISOR = "supervisor"
RECORDER = "recorder"


class Look(NamedTuple):
    """One process at one moment."""

    at_s: float
    memory_mb: float
    handles: int
    threads: int


class Grown(NamedTuple):
    """One process over the run."""

    process: str
    looks: int
    memory_mb: list[float]  # median of each quarter
    handles: list[int]  # most in each quarter
    threads: list[int]
    flat: bool


class Missed(NamedTuple):
    """One quarter of the vehicle's time."""

    cycles: int
    not_solved: int
    late: int
    missing: int

    @property
    def all(self) -> int:
        """Number of cycles missed for any reason."""
        return self.not_solved + self.late + self.missing


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
    names: dict[int, str] = {}
    began = time.monotonic()
    while (at_s := time.monotonic() - began) < wall_s and supervisor.poll() is None:
        for pid, name in [(supervisor.pid, SUPERVISOR), *children(supervisor.pid)]:
            seen = look(pid, at_s)
            if seen is not None:
                names[pid] = name
                looks.setdefault(pid, []).append(seen)
        sys.stderr.write(f"\r{at_s / 60:.1f} of {wall_s / 60:g} min")
        time.sleep(every_s)
    sys.stderr.write("\n")
    return {f"{name} {pid}": looks[pid] for pid, name in names.items()}


def grown(process: str, looks: Sequence[Look], wall_s: float) -> Grown:
    """Return the growth of a process by quarters of the run."""
    quarters = [[one for one in looks if int(QUARTERS * one.at_s / wall_s) == k] for k in range(QUARTERS)]
    memory = [float(np.median([one.memory_mb for one in of])) if of else float("nan") for of in quarters]
    handles = [max((one.handles for one in of), default=0) for of in quarters]
    threads = [max((one.threads for one in of), default=0) for of in quarters]
    growth_mb = memory[-1] - memory[1]
    allowed_mb = max(MOST_GROWTH_MB, MOST_GROWTH * memory[1])
    if process.startswith(RECORDER):
        allowed_mb += INDEX_MB_PER_HOUR * wall_s / 3600.0 / 2  # medians of two quarters that lie half a run apart
    lasting = all(quarters[1:])  # else it was started or ended in between
    flat = not lasting or (growth_mb <= allowed_mb and handles[-1] <= handles[1] and threads[-1] <= threads[1])
    return Grown(process, len(looks), memory, handles, threads, flat)


def missed(recording: Path) -> list[Missed]:
    """Return the missed cycles by quarters of the recording."""
    rows: list[tuple[int, int, int, int]] = []  # time, not solved, late, missing in all
    losses, late_before, lost_before = LossAccounting(), 0, 0
    for message in Recording(recording):
        losses.add(message.key, message.plain["epoch"], message.plain["sequence"])
        if message.kind is Plan and message.plain["cycle_t_ns"] >= 0:
            rows.append((message.t_ns, int(message.plain["origin"] != PlanOrigin.SOLVED), 0, 0))
        elif message.kind is Applied:
            late, lost = int(message.plain["plans_late"]), losses.missing
            rows.append((message.t_ns, -1, late - late_before, lost - lost_before))
            late_before, lost_before = late, lost
    if not rows:
        return []
    first, last = rows[0][0], rows[-1][0]
    quarters: list[list[tuple[int, int, int, int]]] = [[] for _ in range(QUARTERS)]
    for row in rows:
        quarters[min(QUARTERS - 1, QUARTERS * (row[0] - first) // max(1, last - first))].append(row)
    return [_of_quarter(quarter) for quarter in quarters]


def _of_quarter(rows: Iterable[tuple[int, int, int, int]]) -> Missed:
    rows = list(rows)
    plans = [solved for _, solved, _, _ in rows if solved >= 0]
    return Missed(len(plans), sum(plans), sum(row[2] for row in rows), sum(row[3] for row in rows))


def steady(quarters: Sequence[Missed]) -> bool:
    """Return True if the last quarter was no worse than those before."""
    return bool(quarters) and quarters[-1].all <= max(FEW, 2 * max(quarter.all for quarter in quarters[1:-1]))


def main() -> int:
    """Run the soak test and report what grew."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of wall time")
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--every-s", type=float, default=10.0)
    parser.add_argument("--out", type=Path, help="keep the run here")
    parser.add_argument("--json", action="store_true")
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
    processes = [grown(name, seen, wall_s) for name, seen in looks.items()]
    good = all(one.flat for one in processes) and steady(quarters)
    if of.json:
        rows = {"processes": [one._asdict() for one in processes], "quarters": [one._asdict() for one in quarters]}
        print(json.dumps({"minutes": of.minutes, "speed": of.speed, "flat": good, **rows}))
    else:
        _show(processes, quarters, good)
    return 0 if good else 1


def _show(processes: Sequence[Grown], quarters: Sequence[Missed], good: bool) -> None:
    print(f"{'process':<26}{'MB, median by quarter':>34}{'handles':>16}{'threads':>16}")
    for one in processes:
        memory = " ".join(f"{value:8.1f}" for value in one.memory_mb)
        counts = (" ".join(map(str, values)) for values in (one.handles, one.threads))
        print(f"{one.process:<26}{memory:>34}" + "".join(f"{text:>16}" for text in counts), "" if one.flat else " grew")
    for k, quarter in enumerate(quarters, 1):
        print(
            f"quarter {k}: {quarter.cycles} cycles, {quarter.not_solved} not solved, {quarter.late} plans late, "
            f"{quarter.missing} messages missing"
        )
    print("flat" if good else "not flat")


if __name__ == "__main__":
    sys.exit(main())
