"""Status line of the controller: authority, health, age of the input, cycle time, error, clock and rejections."""

from __future__ import annotations

from ltv_mpc.messages import ClockMode, ControllerStatus
from ltv_mpc.node import DEFAULT_SOURCE


def text(status: ControllerStatus, estimates_on: str) -> str:
    """Return a status in one line; ``estimates_on`` is the estimates' key, shown until the first one arrives."""
    health = f"{status.health.value} ({status.health_why})" if status.health_why else status.health.value
    parts = [status.authority.value, health]
    if status.estimate_age_ns is None:
        parts.append(f"no estimate yet on {estimates_on}")
    else:
        parts.append(f"estimate {status.estimate_age_ns / 1e9:.2f} s old")
        if status.applied_age_ns is None:
            parts.append("no `applied` messages: plans count as followed")
    if status.cycle_median_us is not None and status.cycle_p99_us is not None:
        parts.append(f"cycle {status.cycle_median_us / 1e3:.1f} ms (p99 {status.cycle_p99_us / 1e3:.1f})")
    if status.source not in ("", DEFAULT_SOURCE):
        parts.append(f"source {status.source}")
    if status.error_m is not None:
        parts.append(f"error {status.error_m:.2f} m")
    if status.progress is not None:
        parts.append(f"{100 * status.progress:.0f} % of the path")
    if status.clock is not ClockMode.SHARED:
        error = "" if status.clock_error_ns is None else f", within {status.clock_error_ns / 1e6:.1f} ms"
        steps = f", steps: {status.clock_steps}" if status.clock_steps else ""
        parts.append(f"clock {status.clock.value}{error}{steps}")
    if status.checkpoints_failed:
        parts.append(f"{status.checkpoints_failed} checkpoints not written")
    if status.dropped or status.rejected:
        parts.append(f"{status.dropped} dropped, {sum(status.rejected.values())} rejected")
    return " | ".join(parts)
