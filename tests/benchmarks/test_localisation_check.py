"""Localisation check on synthetic records and on a short closed-loop run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.batch import Job
from benchmarks.localisation_check import check
from benchmarks.localisation_check.consistency import band
from benchmarks.localisation_check.probe import Record, Squares, descend
from services.tools import lockstep_run

SHORT = 'title = "4 s of a descent"\n[run]\nduration_s = 4.0\n[plant]\ndepth_m = 5.0\n'


def squares(t_s: list[int], square: list[float], dof: list[int]) -> Squares:
    return Squares(np.array(t_s) * 1_000_000_000, np.array(square), np.array(dof))


def record(drift: tuple[float, float], velocity: tuple[float, float]) -> Record:
    return Record(
        drift_m=np.array(drift),
        velocity_error_mps=np.array(velocity),
        velocity_reported_m2ps2=np.array([4e-6, 4e-6]),
        bound_drift_m2=np.array([0.36, 0.64]),
        bound_velocity_m2ps2=np.array([1e-6, 1e-6]),
        true_error_m=abs(drift[0]),
        nees={"position": squares([0, 1], [3.0, 3.0], [3, 3]), "cells": squares([1], [10.0], [10])},
        nis={"gnss": squares([0], [4.0], [4])},
        min_eigenvalue=1e-12,
        asymmetry=0.0,
        missed=0,
    )


def test_drift_is_held_against_the_bound_and_against_the_velocity_error() -> None:
    """Drift is 200 s x velocity error but for the last axis: figures by hand."""
    work = check.jobs("descent", ("sensors=paper", "run.surface_time_s=1"), first_seed=3, runs=2)
    assert [job.settings[-1] for job in work] == ["run.seed=3", "run.seed=4"]
    result = check.result([record((1.0, 0.6), (5e-3, 3e-3)), record((-0.8, 0.2), (-4e-3, 0.0))], work, wall_s=1.0)
    assert (result.runs, result.first_seed, result.sensors) == (2, 3, "paper")
    assert result.drift_rms_m == pytest.approx(math.sqrt((1.0 + 0.36 + 0.64 + 0.04) / 4))
    assert result.bound_rms_m == pytest.approx(math.sqrt(0.5))
    assert result.ratio == pytest.approx(math.sqrt(0.51 / 0.5))
    assert result.true_error_m == pytest.approx(0.9)
    assert result.slope_s == pytest.approx(200.0)
    assert result.r2 == pytest.approx(1 - 0.04 / 2.04)
    assert result.velocity_error_rms_mps == pytest.approx(math.sqrt(50e-6 / 4))
    assert (result.velocity_reported_rms_mps, result.velocity_bound_rms_mps) == pytest.approx((2e-3, 1e-3))
    assert [(one.name, one.per_dof) for one in result.nees] == [("position", 1.0), ("cells", 1.0)]
    assert [(one.name, one.per_dof) for one in result.nis] == [("gnss", 1.0)]
    assert result.ratio_at_bound[0] < 1 < result.ratio_at_bound[1]
    assert check.failed(result) == []


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("short") / "short.toml"
    path.write_text(SHORT)
    return str(path)


def test_a_watched_run_is_the_same_run_and_its_drift_is_that_of_the_grader(scenario: str) -> None:
    job = Job(scenario, ("sensors=realistic", "run.seed=5"))
    watched = descend(job)
    summary = lockstep_run.run(job.run_config())
    assert summary.localisation_error_m.final == pytest.approx(float(np.hypot(*watched.drift_m)), rel=1e-12)
    assert watched.missed == 0
    assert watched.min_eigenvalue > 0
    assert watched.asymmetry == 0
    # two codes that share nothing but the sensors file
    np.testing.assert_allclose(watched.velocity_reported_m2ps2, watched.bound_velocity_m2ps2, rtol=0.1)
    for name in ("position", "velocity", "heading", "tilt", "adcp_bias", "compass_bias", "mounting", "cells"):
        assert watched.nees[name].t_ns.tolist() == [k * 1_000_000_000 for k in range(5)], name
    assert (np.diff(watched.nees["cells"].dof) >= 0).all()  # what has been seen stays seen
    assert 2 * 14 <= watched.nees["cells"].dof[0] <= watched.nees["cells"].dof[-1] <= 2 * 20
    for name, of in watched.nees.items():
        assert of.square[-1] < band(of.dof[-1], 0.9999)[1], name
    pings = watched.nis["adcp"]
    assert np.diff(pings.t_ns).max() == 333_333_333
    assert 0.8 < pings.square.sum() / pings.dof.sum() < 1.2  # one outlier of 25 deviations left in would be 600
