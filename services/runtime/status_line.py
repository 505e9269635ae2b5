"""Status line of the controller on stderr: updated in place on a terminal, printed every 10 s into a pipe."""

from __future__ import annotations

from typing import TextIO

from ltv_mpc.messages import ClockMode, ControllerStatus
from services.runtime.stopping import Say

PERIOD_US = 10_000_000
ERASE = "\r\x1b[2K"


class StatusLine:
    """Writer of the status line and of all other lines of the process, so that they do not overwrite each other."""

    def __init__(self, name: str, estimates_on: str, out: TextIO) -> None:
        """``estimates_on`` is the estimates' key with its namespace, shown until the first one arrives."""
        self._name = name
        self._estimates_on = estimates_on
        self._out = out
        self._terminal = out.isatty()
        self._shown = ""
        self._due_us: int | None = None

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self._write(f"{ERASE if self._shown else ''}{self._name}: {text}\n{self._shown}")

    def saying(self, say: Say) -> Say:
        """Return ``self.say`` on a terminal, else ``say``."""
        return self.say if self._terminal else say

    def show(self, status: ControllerStatus, now_us: int) -> None:
        """Show the newest status."""
        line = text(status, self._estimates_on)
        if self._terminal:
            self._shown = f"{self._name}: {line}"
            self._write(f"{ERASE}{self._shown}")
        elif self._due_us is None or now_us >= self._due_us:
            self._due_us = now_us + PERIOD_US
            self._write(f"{self._name}: {line}\n")

    def close(self) -> None:
        """Leave the terminal's cursor on a new line."""
        if self._shown:
            self._shown = ""
            self._write("\n")

    def _write(self, text: str) -> None:
        self._out.write(text)
        self._out.flush()


def text(status: ControllerStatus, estimates_on: str) -> str:
    """Return authority, health, input age, cycle time, error, clock and rejections, in one line."""
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
    if status.error_m is not None:
        parts.append(f"error {status.error_m:.2f} m")
    if status.progress is not None:
        parts.append(f"{100 * status.progress:.0f} % of the path")
    if status.clock is not ClockMode.SHARED:
        error = "" if status.clock_error_ns is None else f", within {status.clock_error_ns / 1e6:.1f} ms"
        steps = f", steps: {status.clock_steps}" if status.clock_steps else ""
        parts.append(f"clock {status.clock.value}{error}{steps}")
    if status.dropped or status.rejected:
        parts.append(f"{status.dropped} dropped, {sum(status.rejected.values())} rejected")
    return " | ".join(parts)
