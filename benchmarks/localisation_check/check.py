"""Localisation check over many seeds: the runs, what they are summarised to, and which requirements are not met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace

import msgspec
import numpy as np

from benchmarks.batch import Job, decode, keep_each
from benchmarks.localisation_check.consistency import Consistency, band, consistency
from benchmarks.localisation_check.judgement import (
    LEVEL,
    MIN_DRAWS,
    MIN_SHARE,
    TOLERANCE,
    judge,
    mean_square,
    p_of_mean,
    p_of_ratio,
    p_of_share,
)
from benchmarks.localisation_check.probe import Record, Squares, descend
from ltv_mpc.messages import Array
from services.tools.batch.results_store import ResultsStore

MAX_RATIO = 1.2
"""Largest drift over bound."""


class Quantity(msgspec.Struct, frozen=True, kw_only=True):
    """Consistency of one quantity's error (NEES) or of one sensor's innovation (NIS)."""

    name: str
    per_dof: float
    standard_error: float  # of per_dof, from the spread of the runs
    draws: float  # independent draws of a run over time
    in_band: float  # share of instants


def jobs(scenario: str, settings: Sequence[str], *, first_seed: int, runs: int) -> list[Job]:
    """Return one job for each seed. The first is resolved here, to reject bad input early. Raises ``ConfigError``."""
    common = (*settings, "run.perfect_state=false")
    made = [Job(scenario, (*common, f"run.seed={first_seed + i}")) for i in range(runs)]
    made[0].run_config()
    return made


def measure(work: Sequence[Job], store: ResultsStore) -> list[Record]:
    """Return every run's record in the order of the jobs; those in the store are not made again."""
    keep_each(descend, {_seed(job): job for job in work}, store)
    found = dict(store.results())
    return [decode(found[_seed(job)], Record) for job in work]


def _seed(job: Job) -> str:
    """Return the setting in which the runs differ."""
    return job.settings[-1]


def over_runs(runs: Sequence[Mapping[str, Squares]]) -> dict[str, Consistency]:
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
        result[name] = consistency(square, dof)
    return result


def _quantities(records: Sequence[Record], kind: str) -> tuple[list[Quantity], list[tuple[str, float, str, float]]]:
    """Return the consistency of all quantities of a kind, and the hypotheses about them: name, observed value, limit
    and p-value of every mean, and of the shares that have enough draws.
    """
    runs: list[dict[str, Squares]] = [getattr(record, kind.lower()) for record in records]
    low, high = 1.0 / (1.0 + TOLERANCE), 1.0 + TOLERANCE
    quantities, of_means, of_shares = [], [], []
    for name, of_all in over_runs(runs).items():
        mean, share = mean_square([run[name] for run in runs if name in run]), of_all.in_band
        of_means.append((mean_name(kind, name), mean.value, f"{low:.2f} to {high:.2f}", p_of_mean(mean)))
        if mean.draws >= MIN_DRAWS:
            text = f"share of instants of {kind} of {name} in its band"
            of_shares.append((text, share, f">= {MIN_SHARE}", p_of_share(share, mean.draws)))
        quantities.append(
            Quantity(
                name=name,
                per_dof=mean.value,
                standard_error=mean.standard_error,
                draws=mean.draws,
                in_band=share,
            )
        )
    return quantities, of_means + of_shares


def mean_name(kind: str, name: str) -> str:
    """Return the name of the hypothesis about the mean of a quantity."""
    return f"{kind} of {name} per degree of freedom"


def result(records: Sequence[Record], work: Sequence[Job], *, wall_s: float) -> SimpleNamespace:
    """Compute the content of localisation-check.json. Quantities that the sensors file does not have are left out."""
    first = work[0].run_config()
    drift = np.array([record.drift_m for record in records]).ravel()
    velocity = np.array([record.velocity_error_mps for record in records]).ravel()
    slope = float(velocity @ drift / (velocity @ velocity))
    (nees, nees_tests), (nis, nis_tests) = (_quantities(records, kind) for kind in ("NEES", "NIS"))
    bound_rms = _rms([record.bound_drift_m2 for record in records])
    low, high = band(drift.size)
    ratio = _rms(drift**2) / bound_rms
    of_drift = ("drift over bound", ratio, f"<= {MAX_RATIO}", p_of_ratio(ratio, MAX_RATIO, drift.size))
    return SimpleNamespace(
        scenario=first.name,
        sensors=first.sensor_config.name,
        surface_time_s=first.scenario.run.surface_time_s,
        runs=len(records),
        first_seed=first.scenario.run.seed,
        drift_rms_m=_rms(drift**2),
        bound_rms_m=bound_rms,
        ratio=ratio,
        ratio_at_bound=(
            float(np.sqrt(low / drift.size)),
            float(np.sqrt(high / drift.size)),
        ),  # 95 % interval for a filter at its bound
        true_error_m=float(
            np.mean([record.true_error_m for record in records])
        ),  # of the vehicle from the line, in closed loop
        velocity_error_rms_mps=_rms(velocity**2),  # at t = 0
        velocity_reported_rms_mps=_rms([record.velocity_reported_m2ps2 for record in records]),  # by the filter
        velocity_bound_rms_mps=_rms([record.bound_velocity_m2ps2 for record in records]),
        slope_s=slope,
        r2=float(1.0 - np.sum((drift - slope * velocity) ** 2) / np.sum(drift**2)),
        nees=nees,
        nis=nis,
        min_eigenvalue=min(record.min_eigenvalue for record in records),
        max_asymmetry=max(record.asymmetry for record in records),
        instants_missed=sum(record.missed for record in records),
        family_wise_level=LEVEL,  # probability that the check of a filter within all limits fails
        hypotheses=judge([of_drift, *nees_tests, *nis_tests]),
        wall_s=wall_s,
    )


def failed(of: SimpleNamespace) -> list[str]:
    """List the requirements that are not met."""
    problems = [
        f"{one.name} {one.observed:.3f}, limit {one.limit} (p = {one.p:.1e})" for one in of.hypotheses if one.rejected
    ]
    if not of.min_eigenvalue > 0 or of.max_asymmetry > 0:
        problems.append("a covariance is not symmetric or not positive definite")
    return problems


def _rms(squares: Array | Sequence[Array]) -> float:
    return float(np.sqrt(np.mean(np.asarray(squares))))
