"""Mechanisms of the estimator."""

from __future__ import annotations

from benchmarks.ablation.descent import BEGINS_S, Descent, S
from benchmarks.ablation.mechanism import Event, Mechanism, replaced
from ltv_mpc.localisation import late
from ltv_mpc.messages import AdcpPing
from sim.faults.instruments import Broken, Failure
from sim.faults.spell import Spell

BASE, TESTS = "ltv_mpc/localisation", "tests/ltv_mpc/localisation"


def broken(kind: type, failure: Failure, seconds: float, size: float = 1.0) -> Broken:
    """Return a failure of an instrument from ``BEGINS_S`` on."""
    return Broken(kind, failure, Spell(round(BEGINS_S * S), round((BEGINS_S + seconds) * S)), size, seed=1)


PINGS_LATE = Event(
    "pings late", "pings come 0.5 s late for 40 s", Descent(broken=(broken(AdcpPing, Failure.DELAYED, 40.0, 0.5),))
)

MECHANISMS: tuple[Mechanism, ...] = (
    Mechanism(
        name="out-of-sequence buffer",
        event=PINGS_LATE,
        off=lambda: replaced((late.History, "reaches", lambda *_: False)),
        measures=("true rms m", "drift end m", "velocity rms m/s", "silent"),
        code=(f"{BASE}/late.py",),
        tests=(f"{TESTS}/test_late.py",),
    ),
)
