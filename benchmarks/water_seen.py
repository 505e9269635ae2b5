"""Does the filter notice water that its prior does not foretell, and is its velocity as good as it says?

    .venv/bin/python -m benchmarks.water_seen [--sensors NAME ...] [--runs N] [--seed FIRST] [--only PART ...]
                                              [--currents FILE.csv ...] [--json]

Descents of the full loop in lock step, with a feature of the water that no filter has been told of, in a measured
profile, or with a gyro that fails; each second the true error of velocity (three axes) against the filter's covariance.
    noticed  share of runs whose filter says after the beginning that the water is not as foretold, or that it is itself
             inconsistent, and how long after, median and most. In water as foretold: false alarms
    silent   share of seconds with a velocity beyond chi-square's 99 % while the filter says that all is well: one of
             a hundred in a consistent filter that says nothing
    NEES     of velocity and of the cells that beams have seen, per degree of freedom, after the beginning
    finer    what no cell holds of the water (``sim/evaluation/cells.py``), rms over depth, mean of the runs
    off      rms of the horizontal velocity's error over the last 20 s, and what the filter says of it
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.special import chdtri

from benchmarks.water_detectability import BEGINS_S, Change, front, gyro, step, waves
from ltv_mpc.localisation.filter.state import VELOCITY
from ltv_mpc.messages import Array, Estimate, FilterStatus, LocalisationReport
from ltv_mpc.node import ReceivedMessage
from services.run.run_config import RunConfig
from services.tools.batch.executor import run_each
from services.tools.batch.job import Job
from services.tools.localisation_check.probe import LOOK_NS, Probe

LAST = 20
VELOCITY_AXES = VELOCITY.stop - VELOCITY.start
BEYOND = float(chdtri(VELOCITY_AXES, 0.01))


class Case(NamedTuple):
    """Case of a descent: a change without prediction, or water of another kind."""

    change: Change
    settings: tuple[str, ...] = ()

    @property
    def from_s(self) -> float:
        """When it begins."""
        water = self.change.water
        return 0.0 if self.settings or (water is not None and water.kind != "front") else BEGINS_S

    def job(self, sensors: str, seed: int) -> Job:
        """Its descent."""
        feature = {} if self.change.water is None else msgspec.to_builtins(self.change.water)
        water = [f"water.feature.{key}={json.dumps(value)}" for key, value in feature.items()]
        return Job("descent", (f'sensors="{sensors}"', f"run.seed={seed}", *water, *self.settings))


CHANGES = (
    Change("as foretold"),
    front(0.1, 5.0),
    front(0.2, 5.0),
    front(0.1, 10.0),
    front(0.2, 10.0),
    front(0.1, 15.0),
    front(0.2, 15.0),
    front(0.1, 30.0),
    front(0.2, 30.0),
    waves(0.05, 300.0),
    waves(0.05, 600.0),
    step(0.1),
    step(0.3),
    gyro(10.0),
    gyro(30.0),
    gyro(100.0),
)


class Run(NamedTuple):
    """One descent, at whole seconds (T,)."""

    t_s: Array
    velocity: Array  # (T,) normalised squared error, 3 degrees of freedom
    cells: Array  # (T, 2) of the cells: square, degrees of freedom
    well: Array  # (T,) whether the filter says that all is well
    off: Array  # (T, 2) squares of the horizontal velocity's error and of what the filter says of it (m2/s2)
    subgrid_mps: float  # at the end


class Watch(Probe):
    """Keeps what the filter says besides, and has a gyro fail."""

    message_types = Probe.message_types | {LocalisationReport}

    def __init__(self, run_config: RunConfig, gyro_radps: float) -> None:
        super().__init__(run_config)
        self._to_fail_radps = gyro_radps
        self._said = FilterStatus.NOMINAL
        self.rows: dict[int, tuple[bool, float, float]] = {}

    def published(self, node: str, message: ReceivedMessage) -> None:
        """One message."""
        super().published(node, message)
        match message.message:
            case LocalisationReport() as report:
                self._said = report.status
            case Estimate() as estimate if self.truth is not None and estimate.t_ns % LOOK_NS == 0:
                north, east, _ = self.truth.velocity_mps
                off = (estimate.velocity_north_mps - north) ** 2 + (estimate.velocity_east_mps - east) ** 2
                said = float(np.trace(estimate.covariance[2:4, 2:4])) if estimate.covariance is not None else math.nan
                self.rows[estimate.t_ns] = self._said is FilterStatus.NOMINAL, off, said
        if self.truth is not None and self.truth.t_ns >= BEGINS_S * 1e9:
            self.true_states.imu._bias.value[0] += self._to_fail_radps
            self._to_fail_radps = 0.0


def descend(job: tuple[Job, float]) -> Run:
    """Run it, watched, with a fault of the gyro (rad/s)."""
    run_config = job[0].run_config()
    watch = Watch(run_config, job[1])
    watch.descend()
    velocity, cells = watch.nees["velocity"], watch.nees["cells"]
    of = {t: (square, dof) for t, square, dof in zip(cells.t_ns, cells.square, cells.dof, strict=True)}
    rows = [watch.rows[t] for t in velocity.t_ns.tolist()]
    return Run(
        t_s=velocity.t_ns * 1e-9,
        velocity=velocity.square,
        cells=np.array([of.get(t, (0.0, 0)) for t in velocity.t_ns], dtype=np.float64),
        well=np.array([well for well, _, _ in rows]),
        off=np.array([squares for _, *squares in rows]),
        subgrid_mps=watch.true_states.subgrid_mps(run_config.scenario.end_ns),
    )


def figures(case: Case, runs: Sequence[Run]) -> dict[str, float | None]:
    """Return the figures of one row."""
    told = [run.t_s[(run.t_s >= case.from_s) & ~run.well] - case.from_s for run in runs]
    delays = [float(t[0]) for t in told if len(t)]
    after = np.concatenate([run.t_s >= case.from_s for run in runs])
    velocity = np.concatenate([run.velocity for run in runs])[after]
    cells = np.concatenate([run.cells for run in runs])[after].sum(axis=0)
    well = np.concatenate([run.well for run in runs])[after]
    off, said = np.sqrt(np.mean([run.off[-LAST:].mean(axis=0) for run in runs], axis=0))
    return {
        "runs": len(runs),
        "noticed": len(delays) / len(runs),
        "delay_median_s": float(np.median(delays)) if delays else None,
        "delay_max_s": max(delays, default=None),
        "silent": float((well & (velocity > BEYOND)).mean()),
        "velocity_nees_per_dof": float(velocity.mean() / VELOCITY_AXES),
        "cells_nees_per_dof": float(cells[0] / cells[1]),
        "subgrid_mps": float(np.mean([run.subgrid_mps for run in runs])),
        "off_mps": float(off),
        "said_mps": float(said),
    }


def table(sensors: str, rows: dict[str, dict[str, float | None]]) -> Iterator[str]:
    """One line a case."""
    wide = f"{'noticed':>8}{'after (s)':>12}{'silent':>8}{'NEES v':>8}{'cells':>7}{'finer':>7}{'off, said (cm/s)':>18}"
    yield f"{sensors:<36}{wide}"
    for name, row in rows.items():
        after = "" if row["delay_median_s"] is None else f"{row['delay_median_s']:.0f} to {row['delay_max_s']:.0f}"
        off = f"{100 * (row['off_mps'] or 0.0):.1f}, {100 * (row['said_mps'] or 0.0):.1f}"
        nees = f"{row['velocity_nees_per_dof']:>8.2f}{row['cells_nees_per_dof']:>7.2f}"
        finer = f"{100 * (row['subgrid_mps'] or 0.0):>7.2f}"
        yield f"{name:<36}{row['noticed']:>8.0%}{after:>12}{row['silent']:>8.1%}{nees}{finer}{off:>18}"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="+", default=["paper", "realistic"])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", default=[""], help="cases whose name holds one of these")
    parser.add_argument("--currents", nargs="*", default=[], type=Path)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    measured = [
        Case(Change(file.stem), ('water.kind="measured"', f'water.file="{file.resolve()}"'))
        for file in options.currents
    ]
    cases = [
        case for case in (*map(Case, CHANGES), *measured) if any(part in case.change.name for part in options.only)
    ]
    result: dict[str, dict[str, dict[str, float | None]]] = {}
    for sensors in options.sensors:
        jobs = [
            (case.job(sensors, options.seed + n), case.change.gyro_radps) for case in cases for n in range(options.runs)
        ]
        runs = dict(run_each(descend, jobs))
        result[sensors] = {
            case.change.name: figures(case, [runs[i * options.runs + n] for n in range(options.runs)])
            for i, case in enumerate(cases)
        }
        if not options.json:
            print("\n".join(table(sensors, result[sensors])), end="\n\n", flush=True)
    if options.json:
        print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
