"""Clock master: starts the clock when all nodes are ready, announces it ten times a second, and slows it.

The clock slips when a node cannot keep up, this one included; then its speed is lowered, too (``ClockRate``).
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

import msgspec

from ltv_mpc.messages import Clock, ClockCommand, ClockState, NodeStatus, RunEvent
from services.runtime.clock import ClockSegment, VehicleClock, boot_id, fraction_of
from services.runtime.node_status import MAX_BACKLOG_US

LEAD_US = 50_000
"""Lead time of an announced change: many times the transit time of a message through a router."""

REPEAT_US = 100_000
REPORT_INTERVAL_US = 1_000_000
"""Shortest interval between two events that report slips. One is published when the number of slips has doubled since
the last event, or the speed has halved. Slips are always counted."""
MAX_CATCH_UP_US = 100_000
"""Wall time by which grid steps may be late and still catch up; the clock slips by what is beyond it."""


WINDOW_US = 500_000
FIRST_WINDOW_US = 150_000
"""Window while the speed doubles. A node that cannot keep up reports it within 50 ms."""
MAX_SLIP_RATIO = Fraction(1, 20)
"""Slipped share of a window that does not change the speed: a single hiccup of the machine."""
GROWTH = Fraction(51, 50)  # 2 % a window: about 17 s from half of a speed back to it
REAL_TIME = Fraction(1)
"""The speed is never lowered below real time, or below the requested speed if that is lower; the clock then slips."""


class ClockMasterSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the clock master."""

    start_ns: int
    end_ns: int
    speed: float  # vehicle seconds per second
    expects: tuple[str, ...]  # nodes that must be ready before the clock starts


class ClockRate:
    """Speed of the clock, adapted to a machine that cannot keep the requested one.

    Slips alone do not help a machine that needs three seconds for one second of vehicle time: as soon as the clock
    continues, messages queue again, and each delay is ``speed`` times as long in vehicle time. So the slips within a
    window tell what the machine can do, and set the speed of the next window:

        speed  <-  speed x (1 - slipped / window)       if more than ``MAX_SLIP_RATIO`` of the window slipped
        speed  <-  min(requested, GROWTH x speed)       if nothing slipped

    At first the possible speed is not known, and a run that starts too fast has seconds of vehicle time with stale
    messages. So the clock starts in real time, and its speed doubles with each short window until something slips or
    the requested speed is reached. The same happens when a higher speed is requested.
    """

    def __init__(self, requested: Fraction) -> None:
        self.requested = requested
        self.speed = min(requested, REAL_TIME)
        self._doubles = self.speed < requested
        self._since_us: int | None = None
        self._slipped_us = 0

    def request(self, speed: Fraction) -> None:
        """Request a speed, which is approached as far as the machine can keep it."""
        self.requested = speed
        self.speed = min(speed, max(self.speed, REAL_TIME))
        self._doubles = self.speed < speed
        self.restart_window()

    def restart_window(self) -> None:
        """Discard the current window, because the clock was paused or changed for another reason."""
        self._since_us, self._slipped_us = None, 0

    def add_slip(self, slip_us: int) -> None:
        """Add a slip (wall time)."""
        self._slipped_us += slip_us

    @property
    def window_end_us(self) -> int:
        """Monotonic time (us) at which the window ends; 0 before it starts."""
        return 0 if self._since_us is None else self._since_us + self._window_us

    @property
    def _window_us(self) -> int:
        return FIRST_WINDOW_US if self._doubles else WINDOW_US

    def window_over(self, now_us: int) -> bool:
        """Return True if the window has ended and ``speed`` has changed."""
        if self._since_us is None:
            self._since_us = now_us
        window_us = now_us - self._since_us
        if window_us < self._window_us:
            return False
        before = self.speed
        share = min(Fraction(self._slipped_us, window_us), Fraction(1, 2))
        if share > MAX_SLIP_RATIO:
            self.speed = max(min(self.requested, REAL_TIME), self.speed * (1 - share))
            self._doubles = False
        elif not self._slipped_us:
            self.speed = min(self.requested, self.speed * (2 if self._doubles else GROWTH))
            self._doubles = self._doubles and self.speed < self.requested
        self.speed = self.speed.limit_denominator(1000)
        self._since_us, self._slipped_us = now_us, 0
        return self.speed != before


class ClockMaster:
    """Announcer of the vehicle clock, called by the step loop. ``clock`` is the clock that the process itself reads.

    ``message`` is the newest announcement. It is repeated, so that late joiners receive it too.
    """

    def __init__(
        self,
        settings: ClockMasterSettings,
        clock: VehicleClock,
        *,
        node: str,
        epoch: int,
        now_us: int,
        publish: Callable[[Clock | RunEvent], object],
    ) -> None:
        self.slips = 0
        """Number of slips."""
        self.slipped_ns = 0
        """Vehicle time given up in all, because the machine could not keep up."""
        self._node, self._clock, self._publish = node, clock, publish
        self._rate = ClockRate(fraction_of(settings.speed))
        self._slipping_until_us = 0  # until then the newest slip is still to pass
        self._missing = dict.fromkeys(settings.expects)  # a dict keeps the order of the process table
        self._repeat_us = 0
        self._reported_us, self._reported_slips = -REPORT_INTERVAL_US, 0
        self._reported_speed = self._rate.requested
        self._ended = False
        num, den = self._rate.speed.as_integer_ratio()
        self.message = Clock(
            clock_epoch=epoch,
            clock_sequence=0,
            host_boot_id=boot_id(),
            at_monotonic_us=now_us,
            vehicle_ns=settings.start_ns,
            speed_num=num,
            speed_den=den,
            requested_speed=float(self._rate.requested),
            state=ClockState.WAITING,
        )
        clock.follow(self.message)

    @property
    def due_us(self) -> int:
        """Monotonic time (us) of the next start, speed change or repetition."""
        if self.message.state is ClockState.RUNNING:
            return min(self._repeat_us, self._rate.window_end_us)
        return self._repeat_us if self._missing or self.message.state is ClockState.PAUSED else 0

    @property
    def waiting_for(self) -> str:
        """Names of the nodes that are not ready yet."""
        return ", ".join(self._missing)

    def on_status(self, status: NodeStatus, now_us: int) -> None:
        """Note a node's status. If the node cannot keep up, the clock slips, as it does for this process."""
        if status.ready and not status.finished:
            self._missing.pop(status.node, None)
        self.slip(now_us, status.min_queue_delay_us if status.min_queue_delay_us > MAX_BACKLOG_US else 0)

    def on_command(self, command: ClockCommand, now_us: int) -> None:
        """Change speed, pause or continue, as an operator requests; not before the start or after the run's end."""
        if self._ended:
            return
        changes, state, speed = [], self.message.state, fraction_of(command.speed)
        if speed != self._rate.requested:
            self._rate.request(speed)
            changes.append(f"at {command.speed:g} x real time")
        if command.paused and state is ClockState.RUNNING:
            state = ClockState.PAUSED
            changes.append("paused")
        elif not command.paused and state is ClockState.PAUSED:
            state = ClockState.RUNNING
            changes.append("resumed")
        self._rate.restart_window()
        if changes:
            self._announce(now_us, state)
            self._publish_event(now_us, "clock", f"clock {', '.join(changes)}, as requested")

    def run_due(self, now_us: int) -> None:
        """Start the clock, change its speed, or repeat its announcement, whichever is due."""
        state = self.message.state
        starts = state is ClockState.WAITING and not self._missing
        if starts or (state is ClockState.RUNNING and self._rate.window_over(now_us)):
            self._announce(now_us, ClockState.RUNNING)
        elif now_us >= self._repeat_us:
            self._send(now_us)

    def on_late_step(self, now_us: int, due_us: int) -> None:
        """Note that a grid step that was due at ``due_us`` starts only now."""
        self.slip(now_us, now_us - due_us - MAX_CATCH_UP_US)

    def slip(self, now_us: int, us: int) -> None:
        """Slip by ``us`` of wall time that cannot be caught up with: the clock holds still that much longer.

        It does so only while it runs, and no earlier slip is still to pass.
        """
        if us <= 0 or self.message.state is not ClockState.RUNNING or now_us < self._slipping_until_us:
            return
        slip_ns = us * 1000 * self.message.speed_num // self.message.speed_den
        self._announce(now_us, slip_ns=slip_ns)
        self.slips, self.slipped_ns = self.slips + 1, self.slipped_ns + slip_ns
        self._rate.add_slip(us)
        self._slipping_until_us = self.message.at_monotonic_us + us
        much_more = self.slips >= 2 * self._reported_slips or 2 * self._rate.speed < self._reported_speed
        if now_us - self._reported_us < REPORT_INTERVAL_US or not much_more:
            return
        self._reported_us, self._reported_slips, self._reported_speed = now_us, self.slips, self._rate.speed
        text = (
            f"machine too slow: waits of the clock so far: {self.slips},"
            f" in all {self.slipped_ns / 1e9:.2f} s of vehicle time;"
            f" it continues at {float(self._rate.speed):.3g} x real time"
        )
        self._publish_event(now_us, "slowed", text)

    def stop(self, now_us: int) -> None:
        """Stop the clock: the run is complete."""
        self._ended = True
        self._announce(now_us, ClockState.PAUSED)

    def _announce(self, now_us: int, state: ClockState | None = None, *, slip_ns: int = 0) -> None:
        """Announce a change of the state, of the speed to that of the clock rate, or a slip."""
        old = self.message
        at_us = max(now_us + LEAD_US, old.at_monotonic_us)
        num, den = self._rate.speed.as_integer_ratio()
        self.message = msgspec.structs.replace(
            old,
            clock_sequence=old.clock_sequence + 1,
            at_monotonic_us=at_us,
            vehicle_ns=ClockSegment.announced(old).read(at_us) - slip_ns,
            speed_num=num,
            speed_den=den,
            requested_speed=float(self._rate.requested),
            state=state or old.state,
        )
        self._clock.follow(self.message)
        self._send(now_us)

    def _send(self, now_us: int) -> None:
        self._publish(self.message)
        self._repeat_us = now_us + REPEAT_US

    def _publish_event(self, now_us: int, kind: str, text: str) -> None:
        self._publish(RunEvent(t_ns=self._clock.read(now_us) or 0, node=self._node, kind=kind, text=text))
