"""Status of a controller that waits, for tests of its readers."""

from __future__ import annotations

from ltv_mpc.messages import Authority, ClockMode, ControllerStatus, Health


def status(*, error_m: float | None = None) -> ControllerStatus:
    """Return the status of a controller that waits for estimates."""
    return ControllerStatus(
        t_ns=0,
        estimate_age_ns=None,
        applied_age_ns=None,
        cycle_median_us=None,
        cycle_p99_us=None,
        received=0,
        dropped=0,
        rejected={},
        clock=ClockMode.SHARED,
        clock_error_ns=None,
        authority=Authority.DISARMED,
        health=Health.FAILSAFE,
        health_why="no estimate",
        error_m=error_m,
    )
