"""How fast the clock may go on a machine that cannot keep the speed that was asked for.

A clock that stands still now and then is no cure for a machine that does three seconds of work in one of the wall: as
soon as it goes on, messages wait again, and each waiting is ``speed`` times as long in vehicle time. So what had to be
given up over a window says what the machine can do, and the next window is gone at that pace:

    speed  <-  speed x (1 - given up / window)      where it was more than ``MAX_SLIP_RATIO`` of the window
    speed  <-  min(asked, GROWTH x speed)           where nothing was given up

What it can do is not known at first, and a run that begins too fast begins with seconds of vehicle time in which
nothing is of now. So it begins in real time and doubles, window by short window, until that was too much or enough;
likewise when more speed is asked for.
"""

from __future__ import annotations

from fractions import Fraction

WINDOW_US = 500_000
FIRST_WINDOW_US = 150_000
"""While it doubles. Who cannot keep up says so within 50 ms."""
MAX_SLIP_RATIO = Fraction(1, 20)
"""One hiccup of the machine: the clock waits for it, and goes on as before."""
GROWTH = Fraction(51, 50)  # 2 % a window: 10 s from half the speed to most of it again
REAL_TIME = Fraction(1)
"""Below it no pace is kept: who asks for real time or less gets it, with what has to be given up now and then."""


class ClockRate:
    """Told of every standstill; asked for the speed once a window is over."""

    def __init__(self, requested: Fraction) -> None:
        self.requested = requested
        self.speed = min(requested, REAL_TIME)
        self._doubles = self.speed < requested
        self._since_us: int | None = None
        self._given_up_us = 0

    def request(self, speed: Fraction) -> None:
        """Go at this speed, as soon as it is known to be possible."""
        self.requested = speed
        self.speed = min(speed, max(self.speed, REAL_TIME))
        self._doubles = self.speed < speed
        self.restart_window()

    def restart_window(self) -> None:
        """Forget the window: the clock stood still for another reason."""
        self._since_us, self._given_up_us = None, 0

    def add_slip(self, standstill_us: int) -> None:
        """The clock stands still so long (wall time)."""
        self._given_up_us += standstill_us

    @property
    def window_end_us(self) -> int:
        """Return when the running window ends (monotonic, us); 0 before it has begun."""
        return 0 if self._since_us is None else self._since_us + self._window_us

    @property
    def _window_us(self) -> int:
        return FIRST_WINDOW_US if self._doubles else WINDOW_US

    def window_over(self, now_us: int) -> bool:
        """Whether a window has ended with another ``speed``."""
        if self._since_us is None:
            self._since_us = now_us
        window_us = now_us - self._since_us
        if window_us < self._window_us:
            return False
        before = self.speed
        share = min(Fraction(self._given_up_us, window_us), Fraction(1, 2))
        if share > MAX_SLIP_RATIO:
            self.speed = max(min(self.requested, REAL_TIME), self.speed * (1 - share))
            self._doubles = False
        elif not self._given_up_us:
            self.speed = min(self.requested, self.speed * (2 if self._doubles else GROWTH))
            self._doubles = self._doubles and self.speed < self.requested
        self.speed = self.speed.limit_denominator(1000)
        self._since_us, self._given_up_us = now_us, 0
        return self.speed != before
