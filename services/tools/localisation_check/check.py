"""Localisation check over many seeds: drift relative to its bound, and consistency of errors with the covariance.

drift      of one horizontal axis over the descent, rms over runs and both axes; the bound is that of each run
consistent share of instants at which the NEES of a quantity, or the NIS of a sensor, summed over the runs, lies in the
           95 % band of chi-square
per dof    mean square with its standard error over the runs, because a constant error is one draw per run
slope, R2  of the final drift against the velocity error at submergence, through the origin, both axes
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.messages import Array
from services.tools.batch.executor import run_each
from services.tools.batch.job import Job
from services.tools.batch.results_store import ResultsStore, decode
from services.tools.localisation_check.probe import Record, Squares, descend
from sim.evaluation.consistency import Consistency, band, consistency

MAX_RATIO = 1.2
MIN_SPEED_RATIO = 0.9
CELLS = (0.9, 1.1)
"""Requirements: largest drift over bound, smallest share of instants in the band, mean NEES of the currents."""


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """Content of localisation-check.json. Quantities that the sensors file does not have are left out."""

    scenario: str
    sensors: str
    surface_time_s: float
    runs: int
    first_seed: int
    drift_rms_m: float
    bound_rms_m: float
    ratio: float
    ratio_at_bound: tuple[float, float]  # 95 % interval of such checks for a filter at its bound
    true_error_m: float  # mean distance of the vehicle from the line, over time and runs, in closed loop
    velocity_error_rms_mps: float  # at t = 0
    velocity_reported_rms_mps: float  # by the filter
    velocity_bound_rms_mps: float
    slope_s: float
    r2: float
    nees_in_band: dict[str, float]
    nees_per_dof: dict[str, float]
    nees_standard_error: dict[str, float]  # of nees_per_dof, from the spread of the runs
    cells_nees_per_dof: float
    nis_in_band: dict[str, float]
    nis_per_dof: dict[str, float]
    nis_standard_error: dict[str, float]
    drawn_per_dof: dict[str, float]  # of the true biases: deviation of these seeds from 1
    min_eigenvalue: float
    max_asymmetry: float
    instants_missed: int
    wall_s: float


class Graded(NamedTuple):
    """Consistency of one quantity over time, for the plot."""

    t_s: Array
    consistency: Consistency


def jobs(scenario: str, settings: Sequence[str], *, first_seed: int, runs: int) -> list[Job]:
    """Return one job for each seed. The first is resolved here, to reject bad input early. Raises ``ConfigError``."""
    common = (*settings, "run.perfect_state=false")
    made = [Job(scenario, (*common, f"run.seed={first_seed + i}")) for i in range(runs)]
    made[0].run_config()
    return made


def measure(work: Sequence[Job], store: ResultsStore, *, progress: Callable[[int], None]) -> list[Record]:
    """Return every run's record in the order of the jobs; ``progress`` receives the number of further runs done."""
    missing = [job for job in work if _seed(job) not in store.keys]
    progress(len(work) - len(missing))
    for place, record in run_each(descend, missing):
        store.append(_seed(missing[place]), record)
        progress(1)
    found = dict(store.results())
    return [decode(found[_seed(job)], Record) for job in work]


def _seed(job: Job) -> str:
    """Return the setting in which the runs differ."""
    return job.settings[-1]


def over_runs(runs: Sequence[Mapping[str, Squares]]) -> dict[str, Graded]:
    """Combine the runs by name. A run that lacks an instant does not contribute to it."""
    result = {}
    for name in dict.fromkeys(name for run in runs for name in run):
        have = [run[name] for run in runs if name in run]
        t_ns = np.unique(np.concatenate([one.t_ns for one in have]))
        square, dof = np.zeros((len(have), len(t_ns))), np.zeros((len(have), len(t_ns)), dtype=np.int64)
        for i, one in enumerate(have):
            at = np.searchsorted(t_ns, one.t_ns)
            np.add.at(square[i], at, one.square)
            np.add.at(dof[i], at, one.dof)
        result[name] = Graded(t_s=t_ns[dof.sum(axis=0) > 0] * 1e-9, consistency=consistency(square, dof))
    return result


def standard_error(runs: Sequence[Mapping[str, Squares]], name: str) -> float:
    """Estimate the standard error of the mean square per degree of freedom over the runs.

    Runs are independent, the instants of one run are not.

    With S_r the sum of squares of run r and n_r its degrees of freedom, m = sum S_r / sum n_r (a ratio estimate:
    Cochran 1977, Sampling techniques, section 2.11):  se^2 = R / (R - 1) sum (S_r - m n_r)^2 / (sum n_r)^2
    """
    have = [run[name] for run in runs if name in run]
    S, n = np.array([one.square.sum() for one in have]), np.array([one.dof.sum() for one in have], dtype=np.float64)
    if len(have) < 2:
        return float("nan")
    left = S - S.sum() / n.sum() * n
    return float(np.sqrt(len(have) / (len(have) - 1) * (left @ left)) / n.sum())


def result(records: Sequence[Record], work: Sequence[Job], *, wall_s: float) -> Result:
    """Compute the figures from all records."""
    first = work[0].run_config()
    drift = np.array([record.drift_m for record in records]).ravel()
    velocity = np.array([record.velocity_error_mps for record in records]).ravel()
    slope = float(velocity @ drift / (velocity @ velocity))
    nees = {name: graded.consistency for name, graded in over_runs([record.nees for record in records]).items()}
    nis = {name: graded.consistency for name, graded in over_runs([record.nis for record in records]).items()}
    bound_rms = _rms([record.bound_drift_m2 for record in records])
    low, high = band(drift.size)
    return Result(
        scenario=first.name,
        sensors=first.sensor_config.name,
        surface_time_s=first.scenario.run.surface_time_s,
        runs=len(records),
        first_seed=first.scenario.run.seed,
        drift_rms_m=_rms(drift**2),
        bound_rms_m=bound_rms,
        ratio=_rms(drift**2) / bound_rms,
        ratio_at_bound=(float(np.sqrt(low / drift.size)), float(np.sqrt(high / drift.size))),
        true_error_m=float(np.mean([record.true_error_m for record in records])),
        velocity_error_rms_mps=_rms(velocity**2),
        velocity_reported_rms_mps=_rms([record.velocity_reported_m2ps2 for record in records]),
        velocity_bound_rms_mps=_rms([record.bound_velocity_m2ps2 for record in records]),
        slope_s=slope,
        r2=float(1.0 - np.sum((drift - slope * velocity) ** 2) / np.sum(drift**2)),
        nees_in_band={name: c.in_band for name, c in nees.items()},
        nees_per_dof={name: c.per_dof for name, c in nees.items()},
        nees_standard_error={name: standard_error([record.nees for record in records], name) for name in nees},
        cells_nees_per_dof=nees["cells"].per_dof,
        nis_in_band={name: c.in_band for name, c in nis.items()},
        nis_per_dof={name: c.per_dof for name, c in nis.items()},
        nis_standard_error={name: standard_error([record.nis for record in records], name) for name in nis},
        drawn_per_dof={
            name: sum(record.drawn[name][0] for record in records) / sum(record.drawn[name][1] for record in records)
            for name in records[0].drawn
        },
        min_eigenvalue=min(record.min_eigenvalue for record in records),
        max_asymmetry=max(record.asymmetry for record in records),
        instants_missed=sum(record.missed for record in records),
        wall_s=wall_s,
    )


def failed(of: Result) -> list[str]:
    """List the requirements that are not met."""
    problems = []
    if of.ratio > MAX_RATIO:
        problems.append(f"drift is {of.ratio:.2f} times its bound, must be at most {MAX_RATIO}")
    for kind, shares in (("NEES", of.nees_in_band), ("NIS", of.nis_in_band)):
        problems += [
            f"{kind} of {name} in its band at {100 * share:.0f} % of instants, "
            f"must be at least {100 * MIN_SPEED_RATIO:.0f} %"
            for name, share in shares.items()
            if share < MIN_SPEED_RATIO
        ]
    low, high = CELLS
    if not low <= of.cells_nees_per_dof <= high:
        problems.append(f"NEES of cells per degree of freedom {of.cells_nees_per_dof:.2f}, must be {low} to {high}")
    if not of.min_eigenvalue > 0 or of.max_asymmetry > 0:
        problems.append("a covariance is not symmetric or not positive definite")
    return problems


def table(of: Result) -> str:
    """Format the result as text."""
    low, high = of.ratio_at_bound
    lines = [
        f"{of.runs} runs of {of.scenario}, sensors {of.sensors}, {of.surface_time_s:g} s afloat, "
        f"seeds {of.first_seed} to {of.first_seed + of.runs - 1}, {of.wall_s:.0f} s",
        f"drift     {of.drift_rms_m:.3f} m an axis, bound {of.bound_rms_m:.3f} m, ratio {of.ratio:.2f} "
        f"(at the bound: {low:.2f} to {high:.2f})",
        f"vehicle   {of.true_error_m:.3f} m from the line, mean over time and runs",
        f"velocity  {1e3 * of.velocity_error_rms_mps:.2f} mm/s at submergence, sigma of the filter "
        f"{1e3 * of.velocity_reported_rms_mps:.2f}, bound {1e3 * of.velocity_bound_rms_mps:.2f}; "
        f"drift = {of.slope_s:.0f} s x velocity error, R2 {of.r2:.2f}",
        f"{'':<24} {'in 95 % band':>12} {'per dof':>8} {'+-':>6} {'drawn':>8}",
    ]
    for kind, shares, means, errors in (
        ("NEES", of.nees_in_band, of.nees_per_dof, of.nees_standard_error),
        ("NIS ", of.nis_in_band, of.nis_per_dof, of.nis_standard_error),
    ):
        for name, share in shares.items():
            seeds = f"{of.drawn_per_dof[name]:8.2f}" if kind == "NEES" and name in of.drawn_per_dof else ""
            mean = f"{means[name]:8.2f} {errors[name]:6.2f}"
            lines.append(f"{kind} {name:<19} {100 * share:>10.0f} % {mean} {seeds}".rstrip())
    return "\n".join(lines)


def _rms(squares: Array | Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.asarray(squares))))
