"""Clock commands of an operator: speed, pause, continue; announced ahead, without a step back."""

from __future__ import annotations

from ltv_mpc.messages import Clock, ClockCommand, ClockState, RunEvent
from services.runtime.clock import VehicleClock
from services.runtime.clock_master import LEAD_US, ClockMaster, ClockMasterSettings

MS = 1_000


class Kept:
    """Clock master without a bus, at wall times that the tests set (us)."""

    def __init__(self, *expects: str) -> None:
        self.said: list[Clock | RunEvent] = []
        self.clock = VehicleClock()
        settings = ClockMasterSettings(start_ns=0, end_ns=10**12, speed=1.0, expects=expects)
        self.keeping = ClockMaster(settings, self.clock, epoch=1, now_us=0, publish=self.said.append)
        self.keeping.run_due(0)

    def asked(self, now_us: int, *, paused: bool = False, speed: float = 1.0) -> None:
        self.keeping.on_command(ClockCommand(paused=paused, speed=speed), now_us, "plant")

    def newest(self) -> Clock:
        return next(one for one in reversed(self.said) if isinstance(one, Clock))


def test_a_pause_is_announced_ahead_and_lasts_until_the_clock_resumes() -> None:
    kept = Kept()
    kept.asked(1000 * MS, paused=True)
    assert kept.newest().at_monotonic_us == 1000 * MS + LEAD_US
    still_ns = 1000 * MS * 1000  # start and pause are announced alike: a second in between
    assert kept.clock.read(1000 * MS) == (1000 * MS - LEAD_US) * 1000
    assert kept.clock.read(1000 * MS + LEAD_US) == still_ns
    assert kept.clock.read(5000 * MS) == still_ns
    kept.asked(6000 * MS)
    assert kept.clock.read(6000 * MS + LEAD_US) == still_ns
    assert kept.clock.read(7000 * MS + LEAD_US) == still_ns + 10**9


def test_another_speed_holds_from_its_instant_on() -> None:
    kept = Kept()
    kept.asked(1000 * MS, speed=0.5)
    before_ns = kept.clock.read(1000 * MS + LEAD_US)
    assert before_ns is not None
    assert kept.clock.read(3000 * MS + LEAD_US) == before_ns + 10**9


def test_only_changes_are_announced_and_each_is_an_event() -> None:
    kept = Kept()
    count = len(kept.said)
    kept.asked(1000 * MS)
    assert len(kept.said) == count
    kept.asked(2000 * MS, paused=True, speed=4.0)
    kept.asked(3000 * MS, paused=True, speed=4.0)
    assert [one.text for one in kept.said if isinstance(one, RunEvent)] == [
        "clock at 4 x real time, paused, as requested"
    ]


def test_a_command_neither_starts_the_clock_nor_continues_it_after_the_end() -> None:
    waiting = Kept("controller")
    waiting.asked(1000 * MS)
    waiting.asked(1000 * MS, paused=True, speed=4.0)
    assert waiting.newest().state is ClockState.WAITING
    assert waiting.newest().requested_speed == 4.0
    ended = Kept()
    ended.keeping.stop(1000 * MS)
    ended.asked(2000 * MS)
    assert ended.newest().state is ClockState.PAUSED
