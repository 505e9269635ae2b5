"""Speed of lock step on one core relative to real time, and the share of each node.

    .venv/bin/python -m benchmarks.lockstep [--duration-s T] [--runs N] [--json]

Descents: the full loop with each of the shipped sensor profiles, with the state known, and the full loop recorded; the
best and the median run of each, the first left out.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ltv_mpc.messages import Message
from ltv_mpc.node import Inbox, Node
from services.run.folder import RunFolder
from services.run.nodes import make_nodes
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from sim.scheduler import LockStep

SETTINGS: dict[str, tuple[str, ...]] = {
    "full loop, paper": ("sensors=paper",),
    "full loop, realistic": ("sensors=realistic",),
    "state known": ("run.perfect_state=true",),
}
RECORDED = "full loop, paper, recorded"


def run_config(*settings: str, duration_s: float) -> RunConfig:
    """Resolve the descent with these settings."""
    return resolve("descent", [Override("benchmark", [*settings, f"run.duration_s={duration_s}", "run.seed=3"])])


def run(of: RunConfig, folder: str | None = None) -> float:
    """Return the speed of one run relative to real time; with ``folder`` the run is recorded."""
    seconds = (of.scenario.end_ns - of.scenario.start_ns) * 1e-9
    started = time.perf_counter()
    lockstep_run.run(of, None if folder is None else RunFolder(Path(folder)))
    return seconds / (time.perf_counter() - started)


def shares(of: RunConfig) -> dict[str, float]:
    """Return the share of each node in the time of one run; the rest is validation and lock step itself."""
    spent: Counter[str] = Counter()

    class Timed:
        """A node whose steps are timed."""

        def __init__(self, node: Node) -> None:
            self.name, self.schedule, self.reads, self.writes = node.name, node.schedule, node.reads, node.writes
            self._step = node.step

        def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
            started = time.perf_counter()
            said = self._step(t_ns, inbox)
            spent[self.name] += time.perf_counter() - started
            return said

    nodes = [Timed(node) for node in make_nodes(of, publish_unread_topics=False)]
    lockstep = LockStep(
        nodes, start_ns=of.scenario.start_ns, latest=lockstep_run.LATEST, make_rejection=lockstep_run.rejected_message
    )
    started = time.perf_counter()
    lockstep.advance(of.scenario.end_ns)
    whole = time.perf_counter() - started
    spent["validation and lock step"] = whole - sum(spent.values())
    return {name: seconds / whole for name, seconds in spent.most_common()}


def main() -> None:
    """Run all cases interleaved, so that a slow minute of the machine affects all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration-s", type=float, default=100.0)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    cases = {name: run_config(*settings, duration_s=options.duration_s) for name, settings in SETTINGS.items()}
    recorded = run_config(*SETTINGS["full loop, paper"], duration_s=options.duration_s)
    times: dict[str, list[float]] = {name: [] for name in (*cases, RECORDED)}
    for _ in range(options.runs + 1):
        for name, case in cases.items():
            times[name].append(run(case))
        with tempfile.TemporaryDirectory() as folder:
            times[RECORDED].append(run(recorded, folder))
    figures = {name: {"best": max(t[1:]), "median": statistics.median(t[1:])} for name, t in times.items()}
    of_nodes = shares(cases["full loop, paper"])
    if options.json:
        json.dump({"times_real_time": figures, "shares": of_nodes}, sys.stdout)
        return
    table = Table("descent in lock step, one core", "times real time: best", "median")
    for name, of in figures.items():
        table.add_row(name, f"{of['best']:.0f}", f"{of['median']:.0f}")
    console = Console()
    console.print(table)
    console.print(", ".join(f"{name} {100 * share:.0f} %" for name, share in of_nodes.items()))


if __name__ == "__main__":
    main()
