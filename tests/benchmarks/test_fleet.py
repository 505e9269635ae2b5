"""A fleet in real processes, as small as one can be, and what its figures are made of."""

from __future__ import annotations

import pytest

from benchmarks.fleet import trial
from benchmarks.fleet.fleet import Fleet, namespace
from services.supervisor.loopback import free_port

FLEET = Fleet(
    vehicles=3, vehicle="paper", rate_hz=5.0, seconds=10.0, warm_up_s=1.0, horizon_s=5.0, router="tcp/127.0.0.1:1"
)


def test_the_vehicles_estimates_are_spread_over_a_period_and_come_once_in_each():
    due = [FLEET.due_ns(i, k) for k in range(3) for i in range(3)]
    assert due == sorted(due)
    assert FLEET.due_ns(1, 2) - FLEET.due_ns(1, 1) == 200_000_000
    assert FLEET.due_ns(2, 0) - FLEET.due_ns(1, 0) == pytest.approx(200e6 / 3, abs=1)
    assert namespace(7) != namespace(70)


def test_three_vehicles_are_held_each_on_its_own_keys_by_two_processes():
    """Nobody sees another's messages: they would be rejected, and each vehicle would leave its own point."""
    fleet = Fleet(
        vehicles=3, processes=2, rate_hz=4.0, seconds=2.0, warm_up_s=2.0, router=f"tcp/127.0.0.1:{free_port()}"
    )
    only = trial.run(fleet)
    assert only.controller_processes == 2
    assert only.plans > 0
    assert only.rejected == 0
    assert only.mean_error_m < 0.6  # they begin up to 0.4 m off
    assert 0.0 < only.latency_ms.median <= only.latency_ms.p99
