"""Consistency of the disturbance observer, and the alarm of a wrong vehicle file: right and wrong files, many seeds.

    .venv/bin/python -m benchmarks.observer [--runs N] [--vehicles NAME ...] [--cases TEXT ...] [--jobs N]

Each run follows a square of 20 m from rest, in a current of a fifth of the top speed that nothing tells. Cases are
those of the robustness table. The estimates have an error of the velocity that varies over some seconds, of the
covariance that they tell. The normalised innovation squared has the mean 3 where all is right, and is above 11.3 in 1 %
of the updates; an observer whose noise is larger than the truth has less. A file is named by the first words of its
alarm.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from benchmarks.batch import in_order
from benchmarks.robustness.cases import RIGHT, conditions
from benchmarks.robustness.flights import Row
from benchmarks.strangers.flight import Ours, Start, fly, load
from benchmarks.strangers.tasks import SQUARE, reference, speed_mps
from ltv_mpc.control.disturbance import VELOCITY_ERROR_TIME_S
from ltv_mpc.messages import Applied, Array, Estimate

CASES = (RIGHT, "wind=0.1", "mass=2", "mass=0.5", "drag=0.5", "drag=2", "arm=0.7", "mass=2 drag=0.5 arm=0.7")
VEHICLES = ("light_boat", "surface")
VELOCITY_SD_MPS, YAW_RATE_SD_RADPS = 0.01, 0.003
CORNER_M = 2.0
"""Distance from the second corner at which the model has been excited: by the start and two corners."""
LATE, AFTER_S = 1.2, 45.0
"""Time to the corner over that of the wanted speed, at most; and time flown after it (s)."""
MANY = 11.34
"""Normalised innovation squared that is exceeded in 1 % of the updates of a right model."""


class Run(NamedTuple):
    """Figures of one run."""

    nis: float  # mean
    many: float  # share of updates above ``MANY``
    named: str  # what the file check said first; empty: nothing
    after_s: float  # from the second corner to the name


class Watched(Ours):
    """The controller with noisy estimates, and what its observer says."""

    def __init__(self, vehicle_name: str, seed: int) -> None:
        speed = speed_mps(vehicle_name)
        super().__init__(load(vehicle_name)[1], reference(SQUARE, speed))
        self._rng, self._error, self._t_ns = np.random.default_rng([52, seed]), np.zeros(2), 0
        self.nis: list[float] = []
        self.named, self.named_s = "", np.inf

    def plan(self, estimate: Estimate, t_ns: int, applied: Applied | None) -> tuple[npt.NDArray[np.int64], Array]:
        """Return the plan of one cycle."""
        kept = np.exp(-(estimate.t_ns - self._t_ns) * 1e-9 / VELOCITY_ERROR_TIME_S) if self.nis else 0.0
        self._t_ns = estimate.t_ns
        new = VELOCITY_SD_MPS * np.sqrt(1.0 - kept**2) * self._rng.standard_normal(2)
        self._error = kept * self._error + new
        variances = [1e-4, 1e-4, VELOCITY_SD_MPS**2, VELOCITY_SD_MPS**2, 1e-6, YAW_RATE_SD_RADPS**2]
        estimate = msgspec.structs.replace(
            estimate,
            velocity_north_mps=estimate.velocity_north_mps + self._error[0],
            velocity_east_mps=estimate.velocity_east_mps + self._error[1],
            yaw_rate_radps=estimate.yaw_rate_radps + YAW_RATE_SD_RADPS * self._rng.standard_normal(),
            covariance=np.diag(variances),
        )
        plan = super().plan(estimate, t_ns, applied)
        self.nis.append(self.controller.observer.nis)
        if not self.named and (why := self.controller.vehicle_file_check.why):
            self.named, self.named_s = why.split(" looks")[0].split(" turn as")[0], t_ns * 1e-9
        return plan


def judged(job: tuple[Row, int]) -> Run:
    """Fly one run."""
    row, seed = job
    hull, _ = load(row.vehicle)
    pilot = Watched(row.vehicle, seed)
    start = Start.drawn(seed, 0.3)._replace(heading_rad=0.0)
    corner = np.array(SQUARE[2])
    duration_s = AFTER_S + LATE * 2.0 * corner[1] / speed_mps(row.vehicle)
    flight = fly(row.vehicle, pilot, conditions(row.case, hull), start, duration_s=duration_s)
    corner_s = flight.t_s[np.argmax(np.hypot(*(flight.point - corner).T) < CORNER_M)]
    nis = np.array(pilot.nis[1:])
    return Run(float(nis.mean()), float((nis > MANY).mean()), pilot.named, float(pilot.named_s - corner_s))


def line(row: Row, runs: list[Run]) -> str:
    """Return the row of the table."""
    named = [run for run in runs if run.named]
    what = ", ".join(f"{name} {count}" for name, count in Counter(run.named for run in named).most_common(3))
    after = [run.after_s for run in named]
    times = f"{np.median(after):.0f} / {max(after):.0f}" if named else ""
    nis = [run.nis for run in runs]
    spread = f"{np.mean(nis):.2f} ({min(nis):.2f} to {max(nis):.2f})"
    many = 100.0 * np.mean([run.many for run in runs])
    return f"| {row.vehicle} | {row.case} | {spread} | {many:.1f} | {len(named)} of {len(runs)} | {times} | {what} |"


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100, help="of each row")
    parser.add_argument("--vehicles", nargs="+", default=VEHICLES)
    parser.add_argument("--cases", nargs="+", default=CASES)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    print("| vehicle | case | NIS, mean | above 11.3 (%) | named | s after the second corner | first named |")
    print("|---" * 7 + "|")
    for row in (Row(vehicle, "square", case) for vehicle in options.vehicles for case in options.cases):
        jobs = [(row, seed) for seed in range(1, options.runs + 1)]
        print(line(row, in_order(judged, jobs, workers=options.jobs)), flush=True)


if __name__ == "__main__":
    main()
