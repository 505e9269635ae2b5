"""The controller's word about itself, once a second: ages, cycles, refusals, who is in charge, how well it goes."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence

from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Applied, ControllerStatus, Estimate, Message, Plan
from services.bus.message_validation import MessageValidator
from services.runtime.clock_sync import ClockOffset

PERIOD_US = 1_000_000
LOOKED_BACK_US = 10_000_000
"""Over which the cycles' times are taken."""

StatusSink = Callable[[ControllerStatus, int], None]
"""What takes each word besides the bus, with the monotonic time in microseconds."""


class ControllerStatusReporter:
    """Watches a controller's process. ``shown`` are the status line and the metrics."""

    writes: tuple[type[Message], ...] = (ControllerStatus,)

    def __init__(self, node: ControllerNode, shown: Sequence[StatusSink] = ()) -> None:
        self._node = node
        self._shown = shown
        self._plan: Plan | None = None
        self._estimate: Estimate | None = None
        self._applied_ns: int | None = None
        self._cycles: deque[tuple[int, int]] = deque()  # when each ended, how long it took (us)
        self.due_us = 0

    def on_input(self, signal: Message) -> None:
        """An input was let in."""
        match signal:
            case Estimate():
                self._estimate = signal
            case Applied():
                self._applied_ns = signal.t_ns
            case _:
                pass

    def on_step(self, outputs: Sequence[Message], took_us: int, now_us: int) -> None:
        """A step is done and published."""
        plan = next((signal for signal in outputs if isinstance(signal, Plan)), None)
        if plan is not None:
            self._plan = plan
            self._cycles.append((now_us, took_us))

    def status(self, now_us: int, t_ns: int, validator: MessageValidator, clock: ClockOffset) -> ControllerStatus:
        """The word that is due, shown as well as returned."""
        self.due_us = now_us + PERIOD_US
        while self._cycles and self._cycles[0][0] < now_us - LOOKED_BACK_US:
            self._cycles.popleft()
        took_us = sorted(took for _, took in self._cycles)
        estimate, node = self._estimate, self._node
        refused = Counter(validator.rejected_by_reason)
        if node.arbiter.manual_rejected:
            refused["manual: thrust outside the limits"] = node.arbiter.manual_rejected
        refused.update({f"estimate: {why}": count for why, count in node.controller.estimate_gate.rejected.items()})
        status = ControllerStatus(
            t_ns=t_ns,
            estimate_age_ns=None if estimate is None else t_ns - estimate.t_ns,
            applied_age_ns=None if self._applied_ns is None else t_ns - self._applied_ns,
            cycle_median_us=_quantile(took_us, 0.5),
            cycle_p99_us=_quantile(took_us, 0.99),
            received=validator.received,
            dropped=validator.dropped,
            rejected=dict(refused),
            clock=clock.mode,
            clock_error_ns=clock.error_ns,
            authority=node.arbiter.authority,
            health=node.health(t_ns) if self._plan is None else self._plan.health,
            error_m=self._error_m(),
            progress=None if self._plan is None else self._plan.progress,
            inputs=node.inputs(),
        )
        for show in self._shown:
            show(status, now_us)
        return status

    def _error_m(self) -> float | None:
        """From the newest estimate to where the newest plan steers."""
        if self._plan is None or self._plan.reference_m is None or self._estimate is None:
            return None
        north, east = self._plan.reference_m
        return math.hypot(self._estimate.north_m - north, self._estimate.east_m - east)


def _quantile(in_order: Sequence[int], share: float) -> float | None:
    return float(in_order[math.ceil(share * (len(in_order) - 1))]) if in_order else None
