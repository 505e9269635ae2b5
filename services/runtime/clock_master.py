"""The time-keeper's part in a process: repeat the clock ten times a second, start it when all are ready, slow it."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from ltv_mpc.messages import Clock, ClockCommand, ClockState, NodeStatus, RunEvent
from services.runtime.clock import ClockSource, VehicleClock, fraction_of
from services.runtime.clock_rate import ClockRate
from services.runtime.node_status import MAX_BACKLOG_US

REPEAT_US = 100_000
TELL_US = 1_000_000
"""At most so often it is said that the clock was slowed, when that has come to twice as many times as at the last word,
or the pace to less than half of it; it is counted always."""
MAX_CATCH_UP_US = 100_000
"""By how much wall time the grid may be behind; what is beyond that the clock gives up."""


class ClockMasterSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What the process that keeps the time has to know."""

    start_ns: int
    end_ns: int
    speed: float  # vehicle seconds per second
    expects: tuple[str, ...]  # nodes that must be ready before the clock starts


class ClockMaster:
    """Drives a ``ClockSource`` from a step loop; ``clock`` is what the process itself reads."""

    def __init__(
        self,
        settings: ClockMasterSettings,
        clock: VehicleClock,
        *,
        epoch: int,
        now_us: int,
        publish: Callable[[Clock | RunEvent], object],
    ) -> None:
        self._source = ClockSource(epoch=epoch, start_ns=settings.start_ns, speed=settings.speed, now_us=now_us)
        self._rate = ClockRate(self._source.speed)
        self._still_until_us = 0  # by then what was given up has passed
        self._clock = clock
        self._publish = publish
        self._missing = dict.fromkeys(settings.expects)  # a dict keeps the order of the launch table
        self._repeat_us = 0
        self._told_us, self._told_times, self._told_speed = -TELL_US, 0, self._source.speed
        self._ended = False
        clock.follow(self._source.set_speed(now_us, self._rate.speed))

    @property
    def due_us(self) -> int:
        """Return when ``run_due`` has something to do (monotonic, us): the start, the next rate, or a repetition."""
        match self._source.message.state:
            case ClockState.WAITING if not self._missing:
                return 0
            case ClockState.RUNNING:
                return min(self._repeat_us, self._rate.window_end_us)
            case _:
                return self._repeat_us

    @property
    def waiting_for(self) -> str:
        """The nodes that are not ready."""
        return ", ".join(self._missing)

    def on_status(self, status: NodeStatus, now_us: int, node: str) -> None:
        """Another process's word. Who cannot keep up is waited for, as this process itself is."""
        if status.ready and not status.finished:
            self._missing.pop(status.node, None)
        if self._source.message.state is ClockState.RUNNING:
            self._slip(status.min_queue_delay_us if status.min_queue_delay_us > MAX_BACKLOG_US else 0, now_us, node)

    def on_command(self, command: ClockCommand, now_us: int, node: str) -> None:
        """An operator wants time to go on otherwise; who waits for the start keeps waiting, and an end is an end."""
        if self._ended:
            return
        said = []
        if fraction_of(command.speed) != self._source.speed:
            self._rate.request(fraction_of(command.speed))
            self._change(self._source.set_speed(now_us, self._rate.speed, requested=command.speed), now_us)
            said.append(f"at {command.speed:g} x real time")
        if command.paused and self._source.message.state is ClockState.RUNNING:
            self._change(self._source.pause(now_us), now_us)
            said.append("paused")
        elif not command.paused and self._source.message.state is ClockState.PAUSED:
            self._change(self._source.run(now_us), now_us)
            said.append("resumed")
        self._rate.restart_window()
        if said:
            text = f"clock {', '.join(said)}, as requested"
            self._publish(RunEvent(t_ns=self._clock.read(now_us) or 0, node=node, kind="clock", text=text))

    def run_due(self, now_us: int) -> None:
        """What is due by the wall: the start, the repetition."""
        if self._source.message.state is ClockState.WAITING and not self._missing:
            self._change(self._source.run(now_us), now_us)
        elif self._source.message.state is ClockState.RUNNING and self._rate.window_over(now_us):
            self._change(self._source.set_speed(now_us, self._rate.speed), now_us)
        elif now_us >= self._repeat_us:
            self._send(now_us)

    def on_late_step(self, now_us: int, due_us: int, node: str) -> None:
        """A step of the grid that was due at ``due_us`` starts only now."""
        self._slip(now_us - due_us - MAX_CATCH_UP_US, now_us, node)

    def _slip(self, us: int, now_us: int, node: str) -> None:
        """So much of wall time that nobody catches up with."""
        if us <= 0 or now_us < self._still_until_us:  # it is waited for already
            return
        self._change(self._source.slip(now_us, us), now_us)
        self._rate.add_slip(us)
        self._still_until_us = self._source.message.at_monotonic_us + us
        much_more = self._source.slips >= 2 * self._told_times or 2 * self._rate.speed < self._told_speed
        if now_us - self._told_us < TELL_US or not much_more:
            return
        self._told_us, self._told_times, self._told_speed = now_us, self._source.slips, self._rate.speed
        text = (
            f"clock slowed {self._source.slips} times, by {self._source.slipped_ns / 1e9:.2f} s of vehicle time in all;"
            f" now at {float(self._rate.speed):.3g} x real time"
        )
        self._publish(RunEvent(t_ns=self._clock.read(now_us) or 0, node=node, kind="slowed", text=text))

    def stop(self, now_us: int) -> None:
        """The run is complete: time stands still for whoever is left."""
        self._ended = True
        self._change(self._source.pause(now_us), now_us)

    def _change(self, message: Clock, now_us: int) -> None:
        self._clock.follow(message)
        self._send(now_us)

    def _send(self, now_us: int) -> None:
        self._publish(self._source.message)
        self._repeat_us = now_us + REPEAT_US
