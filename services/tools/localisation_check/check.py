"""Localisation check over many seeds: drift relative to its bound, and consistency of errors with the covariance.

drift      of one horizontal axis over the descent, rms over runs and both axes; the bound is that of each run
per dof    mean NEES of a quantity or NIS of a sensor, with its standard error over the runs
in band    share of instants at which their sum over the runs lies in the 95 % band of chi-square; judged only if a run
           has enough independent draws over time
slope, R2  of the final drift against the velocity error at submergence, through the origin, both axes

``judgement.py`` says when a figure is outside its limit.
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
from services.tools.localisation_check.judgement import (
    LEVEL,
    MIN_DRAWS,
    MIN_SHARE,
    TOLERANCE,
    Hypothesis,
    Mean,
    judge,
    mean_square,
    p_of_mean,
    p_of_ratio,
    p_of_share,
)
from services.tools.localisation_check.probe import Record, Squares, descend
from sim.evaluation.consistency import Consistency, band, consistency

MAX_RATIO = 1.2
"""Largest drift over bound."""


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
    nees_draws: dict[str, float]  # independent draws of a run over time
    nis_in_band: dict[str, float]
    nis_per_dof: dict[str, float]
    nis_standard_error: dict[str, float]
    nis_draws: dict[str, float]
    drawn_per_dof: dict[str, float]  # of the true biases: deviation of these seeds from 1
    min_eigenvalue: float
    max_asymmetry: float
    instants_missed: int
    family_wise_level: float  # probability that the check of a filter within all limits fails
    hypotheses: list[Hypothesis]
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


def means(runs: Sequence[Mapping[str, Squares]]) -> dict[str, Mean]:
    """Return the mean square of each quantity over the runs."""
    return {name: mean_square([run[name] for run in runs if name in run]) for name in over_runs(runs)}


def _hypotheses(kind: str, of: Mapping[str, Mean], graded: Mapping[str, Graded]) -> list[tuple[str, float, str, float]]:
    """Return name, observed value, limit and p-value of every mean, and of the shares that have enough draws."""
    low, high = 1.0 / (1.0 + TOLERANCE), 1.0 + TOLERANCE
    tests = [
        (f"{kind} of {name} per degree of freedom", mean.value, f"{low:.2f} to {high:.2f}", p_of_mean(mean))
        for name, mean in of.items()
    ]
    for name, mean in of.items():
        if mean.draws >= MIN_DRAWS:
            share = graded[name].consistency.in_band
            tests.append(
                (
                    f"share of instants of {kind} of {name} in its band",
                    share,
                    f">= {MIN_SHARE}",
                    p_of_share(share, mean.draws),
                )
            )
    return tests


def result(records: Sequence[Record], work: Sequence[Job], *, wall_s: float) -> Result:
    """Compute the figures from all records."""
    first = work[0].run_config()
    drift = np.array([record.drift_m for record in records]).ravel()
    velocity = np.array([record.velocity_error_mps for record in records]).ravel()
    slope = float(velocity @ drift / (velocity @ velocity))
    nees_runs, nis_runs = [record.nees for record in records], [record.nis for record in records]
    nees, nis = over_runs(nees_runs), over_runs(nis_runs)
    nees_means, nis_means = means(nees_runs), means(nis_runs)
    bound_rms = _rms([record.bound_drift_m2 for record in records])
    low, high = band(drift.size)
    ratio = _rms(drift**2) / bound_rms
    tests = [("drift over bound", ratio, f"<= {MAX_RATIO}", p_of_ratio(ratio, MAX_RATIO, drift.size))]
    tests += [*_hypotheses("NEES", nees_means, nees), *_hypotheses("NIS", nis_means, nis)]
    return Result(
        scenario=first.name,
        sensors=first.sensor_config.name,
        surface_time_s=first.scenario.run.surface_time_s,
        runs=len(records),
        first_seed=first.scenario.run.seed,
        drift_rms_m=_rms(drift**2),
        bound_rms_m=bound_rms,
        ratio=ratio,
        ratio_at_bound=(float(np.sqrt(low / drift.size)), float(np.sqrt(high / drift.size))),
        true_error_m=float(np.mean([record.true_error_m for record in records])),
        velocity_error_rms_mps=_rms(velocity**2),
        velocity_reported_rms_mps=_rms([record.velocity_reported_m2ps2 for record in records]),
        velocity_bound_rms_mps=_rms([record.bound_velocity_m2ps2 for record in records]),
        slope_s=slope,
        r2=float(1.0 - np.sum((drift - slope * velocity) ** 2) / np.sum(drift**2)),
        nees_in_band={name: graded.consistency.in_band for name, graded in nees.items()},
        nees_per_dof={name: mean.value for name, mean in nees_means.items()},
        nees_standard_error={name: mean.standard_error for name, mean in nees_means.items()},
        nees_draws={name: mean.draws for name, mean in nees_means.items()},
        nis_in_band={name: graded.consistency.in_band for name, graded in nis.items()},
        nis_per_dof={name: mean.value for name, mean in nis_means.items()},
        nis_standard_error={name: mean.standard_error for name, mean in nis_means.items()},
        nis_draws={name: mean.draws for name, mean in nis_means.items()},
        drawn_per_dof={
            name: sum(record.drawn[name][0] for record in records) / sum(record.drawn[name][1] for record in records)
            for name in records[0].drawn
        },
        min_eigenvalue=min(record.min_eigenvalue for record in records),
        max_asymmetry=max(record.asymmetry for record in records),
        instants_missed=sum(record.missed for record in records),
        family_wise_level=LEVEL,
        hypotheses=judge(tests),
        wall_s=wall_s,
    )


def failed(of: Result) -> list[str]:
    """List the requirements that are not met."""
    problems = [
        f"{one.name} {one.observed:.3f}, limit {one.limit} (p = {one.p:.1e})" for one in of.hypotheses if one.rejected
    ]
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
        f"judged at a family-wise level of {100 * of.family_wise_level:g} % (Holm), {len(of.hypotheses)} hypotheses",
        f"{'':<24} {'per dof':>8} {'+-':>6} {'p':>6} {'in 95 % band':>12} {'drawn':>8}",
    ]
    p = {one.name: one.p for one in of.hypotheses}
    for kind, shares, values, errors, draws in (
        ("NEES", of.nees_in_band, of.nees_per_dof, of.nees_standard_error, of.nees_draws),
        ("NIS", of.nis_in_band, of.nis_per_dof, of.nis_standard_error, of.nis_draws),
    ):
        for name, share in shares.items():
            seeds = f"{of.drawn_per_dof[name]:8.2f}" if kind == "NEES" and name in of.drawn_per_dof else ""
            mean = f"{values[name]:8.2f} {errors[name]:6.2f} {p[f'{kind} of {name} per degree of freedom']:6.2f}"
            judged = f"{100 * share:>10.0f} %" if draws[name] >= MIN_DRAWS else f"{'few draws':>12}"
            lines.append(f"{kind:<4} {name:<19} {mean} {judged} {seeds}".rstrip())
    return "\n".join(lines)


def _rms(squares: Array | Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.asarray(squares))))
