"""Benefit of position fixes below the surface: 30 min of hovering at 20 m, without them and with each.

    .venv/bin/python -m benchmarks.aiding [--seed N] [--duration-s T] [--out FILE.png]

Realistic sensors, full loop in lock step; the sensors files are those of examples/. The sea bed lies at 35 m.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks import sheet
from benchmarks.lockstep_job import Job
from ltv_mpc.messages import Array, Estimate, Truth
from services.reporting.plots import palette
from services.run.nodes import make_nodes
from services.tools import lockstep_run
from services.tools.batch.executor import run_each
from sim.scheduler import LockStep, Observation

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "sensors"
SUITES = {
    "none": "realistic",
    "bottom track": str(EXAMPLES / "bottom_track.toml"),
    "USBL": str(EXAMPLES / "usbl.toml"),
    "LBL": str(EXAMPLES / "lbl.toml"),
}
BOTTOM_M = 35.0


class Drift(NamedTuple):
    """Position error of one run, each second."""

    t_s: Array
    error_m: Array  # horizontal, absolute
    sd_m: Array  # of the worse axis, as the filter says


class _Log:
    def __init__(self) -> None:
        self.truth: dict[int, Truth] = {}
        self.rows: list[tuple[float, float, float]] = []

    def published(self, _node: str, message: Any) -> None:
        signal = message.message
        if isinstance(signal, Truth):
            self.truth = {signal.t_ns: signal}
        elif isinstance(signal, Estimate) and signal.t_ns % 1_000_000_000 == 0 and signal.covariance is not None:
            truth = self.truth.get(signal.t_ns)
            if truth is not None:
                north, east = signal.north_m - truth.position_m[0], signal.east_m - truth.position_m[1]
                sd = float(np.sqrt(max(signal.covariance[0, 0], signal.covariance[1, 1])))
                self.rows.append((signal.t_ns * 1e-9, float(np.hypot(north, east)), sd))


def hover(job: Job) -> Drift:
    """One run."""
    run_config, log = job.run_config(), _Log()
    lockstep = LockStep(
        make_nodes(run_config),
        start_ns=run_config.scenario.start_ns,
        latest=lockstep_run.LATEST,
        observation=Observation(log),
    )
    lockstep.advance(run_config.scenario.end_ns)
    return Drift(*np.array(log.rows).T)


def draw(drifts: dict[str, Drift], path: Path) -> None:
    """Draw the error over time with 3 sigma: a panel for each run, all on one scale."""
    with sheet.style(page=True):
        figure = Figure(figsize=(sheet.PAGE_IN, 5.0), layout="constrained")
        panels = figure.subplots(2, 2, sharex=True, sharey=True)
        for panel, (name, drift) in zip(panels.flat, drifts.items(), strict=True):
            minutes = drift.t_s / 60.0
            band = {"color": palette.ESTIMATE, "alpha": 0.2, "linewidth": 0}
            panel.fill_between(minutes, 0.0, 3.0 * drift.sd_m, **band, label="3 sigma of the filter")
            panel.plot(minutes, drift.error_m, color=palette.ESTIMATE, label="error of the estimate")
            panel.set_title(f"With {name}" if name != "none" else "Without fixes below the surface")
            panel.set_yscale("symlog", linthresh=1.0)
            panel.set_ylim(0.0, 60.0)
            panel.set_yticks([0, 0.5, 1, 3, 10, 30], ["0", "0.5", "1", "3", "10", "30"])
        for panel in panels[:, 0]:
            panel.set_ylabel("horizontal error (m)")
        for panel in panels[1]:
            panel.set_xlabel("time (min)")
        sheet.shared_legend(figure, panels[0, 0])
        sheet.write(figure, [path])


def main() -> None:
    """Print the table, and draw the picture if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--duration-s", type=float, default=1800.0)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--workers", type=int)
    options = parser.parse_args()
    common = (f"run.seed={options.seed}", f"run.duration_s={options.duration_s}", f"water.bottom_m={BOTTOM_M}")
    jobs = [Job("hover", (f"sensors={suite}", *common)) for suite in SUITES.values()]
    found: dict[int, Drift] = dict(run_each(hover, jobs, workers=options.workers))
    drifts = {name: found[i] for i, name in enumerate(SUITES)}
    print(f"{'fixes':<14}{'error at end':>14}{'3 sigma':>10}{'largest after 60 s':>20}   m")
    for name, drift in drifts.items():
        largest = drift.error_m[drift.t_s > 60.0].max()
        print(f"{name:<14}{drift.error_m[-1]:>14.2f}{3 * drift.sd_m[-1]:>10.2f}{largest:>20.2f}")
    if options.out is not None:
        draw(drifts, options.out)


if __name__ == "__main__":
    main()
