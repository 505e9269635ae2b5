"""Adaptive clock speed, for a machine that cannot keep the requested speed.

Slips alone do not help a machine that needs three seconds for one second of vehicle time: as soon as the clock
continues, messages queue again, and each delay is ``speed`` times as long in vehicle time. So the slips within a window
tell what the machine can do, and set the speed of the next window:

    speed  <-  speed x (1 - slipped / window)       if more than ``MAX_SLIP_RATIO`` of the window slipped
    speed  <-  min(requested, GROWTH x speed)       if nothing slipped

At first the possible speed is not known, and a run that starts too fast has seconds of vehicle time with stale
messages. So the clock starts in real time, and its speed doubles with each short window until something slips or the
requested speed is reached. The same happens when a higher speed is requested.
"""

from __future__ import annotations

from fractions import Fraction

WINDOW_US = 500_000
FIRST_WINDOW_US = 150_000
"""Window while the speed doubles. A node that cannot keep up reports it within 50 ms."""
MAX_SLIP_RATIO = Fraction(1, 20)
"""Slipped share of a window that does not change the speed: a single hiccup of the machine."""
GROWTH = Fraction(51, 50)  # 2 % a window: about 17 s from half of a speed back to it
REAL_TIME = Fraction(1)
"""The speed is never lowered below real time, or below the requested speed if that is lower; the clock then slips."""


class ClockRate:
    """Speed of the clock, from the slips of the last window."""

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
