"""Sensor screening: reject measurements that are implausible by themselves, before the filter uses them.

future  The stamp is later than the arrival: a clock has jumped. A belief that followed it would reject all true
        measurements after it as late.
stale   The stamp is earlier than that of a previous message of the sensor, and the message has taken much longer than
        that one: messages arrive in order, so a clock has jumped back. The messages after it are stale too, until one
        takes no longer than usual; then the stamps are right again. (A message that a bus has delayed beyond newer
        ones is rejected as well. Sensors with several sources are exempt: their messages arrive in any order.)
stuck   The reading equals the last one to the bit, at another time. Every sensor has noise, so this one repeats itself,
        and the filter would trust its position more with each repetition. A single number, such as a depth, may repeat
        by rounding; for several at once that is next to impossible.
jump    An inertial sample differs from the one before by more than a vehicle can do in between, 0.2 rad/s and 2 m/s2
        every 10 ms. Samples after it are rejected until ``MIN_CONSISTENT`` in a row are consistent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ltv_mpc.localisation.sensors import SENSORS
from ltv_mpc.messages import ImuSample, Message, Triple

MAX_CLOCK_LEAD_NS = 250_000_000
"""Maximum difference between the stamp and the arrival time of a message. It covers clocks that differ a little."""

MAX_ANGULAR_ACCELERATION_RADPS2, MAX_JERK_MPS3 = 20.0, 200.0
MIN_INTERVAL_S = 0.01
"""Minimum interval for which these limits are evaluated: faster units also measure vibration."""

MIN_CONSISTENT = 5

_READINGS: Mapping[type[Message], Callable[[Any], object]] = {
    sensor.message: sensor.reading for sensor in SENSORS if sensor.reading is not None
}
_IN_ORDER: frozenset[type[Message]] = frozenset(sensor.message for sensor in SENSORS if sensor.source is None)
"""Messages that arrive in order of their validity times, because they have a single source."""


@dataclass(slots=True)
class _Arrivals:
    """Arrivals of one sensor."""

    newest_ns: int  # stamp of the newest message
    delay_ns: int  # of that message, from its stamp to its arrival
    is_back: bool = False  # an earlier stamp has arrived since


class SensorScreening:
    """Plausibility checks that compare each message with the last one of its sensor."""

    def __init__(self) -> None:
        self._last: dict[type[Message], tuple[int, object]] = {}
        self._sample: ImuSample | None = None
        self._required = 0
        self._arrivals: dict[type[Message], _Arrivals] = {}

    def rejection(self, t_ns: int, message: Message, received_ns: int) -> str | None:
        """Return why a message must not be used, as a key of the account; None if it is plausible.

        Parameters
        ----------
        t_ns : validity time of the message (ns).
        message : message of any sensor.
        received_ns : time of its arrival (ns).
        """
        if t_ns > received_ns + MAX_CLOCK_LEAD_NS:
            return "future"
        kind = type(message)
        if kind in _IN_ORDER and self._is_stale(kind, t_ns, received_ns):
            return "stale"
        read = _READINGS.get(kind)
        if read is not None:
            reading = read(message)
            before_ns, before = self._last.get(kind, (t_ns, None))
            self._last[kind] = t_ns, reading
            if reading is not None and reading == before and t_ns != before_ns:
                return "stuck"
        return "jump" if isinstance(message, ImuSample) and self._jumps(message) else None

    def _is_stale(self, kind: type[Message], t_ns: int, received_ns: int) -> bool:
        delay_ns = received_ns - t_ns
        arrivals = self._arrivals.get(kind)
        if arrivals is None:
            self._arrivals[kind] = _Arrivals(t_ns, delay_ns)
            return False
        arrivals.is_back = arrivals.is_back or t_ns < arrivals.newest_ns - MAX_CLOCK_LEAD_NS
        if arrivals.is_back and delay_ns > arrivals.delay_ns + MAX_CLOCK_LEAD_NS:
            return True
        if t_ns >= arrivals.newest_ns:
            arrivals.newest_ns, arrivals.delay_ns, arrivals.is_back = t_ns, delay_ns, False
        return False

    def _jumps(self, sample: ImuSample) -> bool:
        before, self._sample = self._sample, sample
        if before is None or before.t_ns == sample.t_ns:
            return False
        seconds = max(abs(sample.t_ns - before.t_ns) * 1e-9, MIN_INTERVAL_S)
        rate_jumps = _differs(
            sample.angular_rate_radps, before.angular_rate_radps, MAX_ANGULAR_ACCELERATION_RADPS2 * seconds
        )
        if rate_jumps or _differs(sample.specific_force_mps2, before.specific_force_mps2, MAX_JERK_MPS3 * seconds):
            self._required = MIN_CONSISTENT
        elif self._required:
            self._required -= 1
        return self._required > 0


def _differs(a: Triple, b: Triple, limit: float) -> bool:
    """Return True if a component differs by more than the limit."""
    return abs(a[0] - b[0]) > limit or abs(a[1] - b[1]) > limit or abs(a[2] - b[2]) > limit
