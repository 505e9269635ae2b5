"""Own clock: stamps of a clock that is set reach the controller in its own time, and plans return by that clock."""

from __future__ import annotations

import msgspec
import pytest

from benchmarks.faults.effects import Interval
from benchmarks.faults.own_clock import ClockStepFault, OwnClock
from ltv_mpc.messages import ClockStep, Estimate
from ltv_mpc.node import ReceivedMessage

S, MS = 1_000_000_000, 1_000_000


@pytest.mark.parametrize("step_s", [-3600.0, -20.0, 0.5, 3600.0])
def test_after_a_step_the_stamps_are_soon_those_without_it(step_s: float) -> None:
    clock = OwnClock([ClockStepFault(Interval(5 * S, 10 * S), round(step_s * S))], epoch=1)
    off_ms, steps = {}, []
    for i in range(150):
        t_ns = 100 * MS * i
        message = ReceivedMessage(msgspec.structs.replace(Estimate.at_rest(), t_ns=t_ns), 1, i, t_ns)
        for delivery in clock.carry("estimator", "controller", message):
            if isinstance(delivery.message.message, ClockStep):
                steps.append(delivery.message)
            else:
                off_ms[t_ns] = (delivery.message.message.t_ns - t_ns) / MS  # type: ignore[attr-defined]
    assert {t_ns: off for t_ns, off in off_ms.items() if not 5 * S <= t_ns < 6 * S and abs(off) > 60.0} == {}
    (step,) = steps
    assert step.message.step_ns == pytest.approx(step_s * S, abs=50 * MS)  # type: ignore[attr-defined]
    assert 5 * S < step.received_t_ns <= 6 * S
