"""Tail of the cycle time on a busy machine: 10 Hz for ten minutes, with load on every core.

    .venv/bin/python -m benchmarks.tail [--minutes 10] [--rate-hz 10] [--busy N] [--min-delay-s 0.08]
                                      [--out DIR] [--json]

`hover` by `ltv-mpc sim` in real time, its recorder, plant, sensors and estimator beside the controller, and N processes
(one a core) that count as fast as they can, at the usual priority. A miss is a plan that came after the start it was
made for. ``[controller] min_delay_s`` is what every plan is given at least: what an ordinary process may have to wait
for a processor shows up too seldom to be learned.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

COUNTS = "while True: pass"


def fly(folder: Path, *, minutes: float, rate_hz: float, busy: int, min_delay_s: float) -> dict[str, Any]:
    """Make the run and return its summary."""
    command = [
        *(sys.executable, "-P", "-m", "services.cli", "sim", "hover", "--speed", "1", "--json", "--out", str(folder)),
        *("--duration-s", str(60.0 * minutes), "--surface-time-s", "10"),
        *("--set", f"controller.period_s={1.0 / rate_hz!r}"),
        *("--set", f"controller.min_delay_s={min_delay_s!r}"),
    ]
    with ExitStack() as ended:
        for _ in range(busy):
            other = subprocess.Popen([sys.executable, "-c", COUNTS])
            ended.callback(other.wait)
            ended.callback(other.kill)
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    summary: dict[str, Any] = json.loads(done.stdout)
    return summary


def main() -> int:
    """Run and print; exit 1 where a plan came late."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate-hz", type=float, default=10.0)
    parser.add_argument("--busy", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--min-delay-s", type=float, default=0.08)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.out or Path(scratch) / "run"
        told = fly(
            folder,
            minutes=options.minutes,
            rate_hz=options.rate_hz,
            busy=options.busy,
            min_delay_s=options.min_delay_s,
        )
    if options.json:
        print(json.dumps(told))
    else:
        compute, whole = told["compute_delay_wall_s"], told["end_to_end_delay_wall_s"]
        print(f"{told['cycles']} cycles, {told['deadline_misses']} deadline misses, {told['qp_status']}")
        for name, of in (("from a cycle's start to its plan", compute), ("from the estimate to the thrust", whole)):
            print(f"{name} (ms): " + ", ".join(f"{key} {1e3 * of[key]:.1f}" for key in ("median", "p99", "max")))
    return 1 if told["deadline_misses"] else 0


if __name__ == "__main__":
    sys.exit(main())
