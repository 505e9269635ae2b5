"""The latency profile measures what it says, on cycles that were solved."""

from __future__ import annotations

import json

import pytest

from services.cli.app import run
from services.measure import profile


def test_each_horizon_has_its_row_and_the_cycle_is_the_sum_of_its_stages(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["profile", "--horizons", "2.5, 5", "--cycles", "10", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["stages"], row["cycles"]) for row in rows] == [(8, 10), (17, 10)]
    for row in rows:
        times = row["times"]
        stages = [name for name in times if name != profile.TOTAL]
        assert {"predict", "linearise", "solve"} <= set(stages)
        for t in times.values():
            assert 0 < t["median_us"] <= t["p90_us"] <= t["p99_us"] <= t["max_us"]
        assert max(times[name]["max_us"] for name in stages) <= times[profile.TOTAL]["max_us"]
        assert times[profile.TOTAL]["max_us"] <= sum(times[name]["max_us"] for name in stages) + 1e-6


def test_the_table_has_a_line_for_each_stage() -> None:
    times = {"cycle": profile.Times(median_us=1000, p90_us=2000, p99_us=3000, max_us=4000)}
    row = profile.Row(horizon_s=5.1, stages=17, cycles=600, solver="osqp", solved=600, times=times)
    header, line = profile.table([row]).splitlines()
    assert header.split() == ["horizon", "stages", "cycles", "stage", "median", "p90", "p99", "max", "ms"]
    assert line.split() == ["5.1", "s", "17", "600", "cycle", "1.000", "2.000", "3.000", "4.000"]
