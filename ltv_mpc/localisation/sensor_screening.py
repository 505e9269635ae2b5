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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ltv_mpc.jit import jit
from ltv_mpc.localisation.filter.preintegration import sample_matrix
from ltv_mpc.localisation.sensors import SENSORS
from ltv_mpc.messages import Array, ImuSample, Message, Triple

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
        self._measured: Array | None = None  # of that sample, (1, 6), if it was one of many
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

    def accepts_all(self, samples: Sequence[ImuSample], received_ns: Sequence[int], measured: Array) -> bool:
        """Return True if a quick check shows that all of these samples are plausible.

        Parameters
        ----------
        samples : (K,) inertial samples in order of arrival.
        received_ns : (K,) times of their arrival (ns).
        measured : (K, 6) their angular rates (rad/s) and specific forces (m/s2), body axes.

        Returns
        -------
        False also if the quick check cannot tell; then ``rejection`` decides for each sample.
        """
        arrivals, before = self._arrivals.get(ImuSample), self._sample
        if arrivals is None or arrivals.is_back or before is None or self._required:
            return False
        stamps = [before.t_ns, *[sample.t_ns for sample in samples]]
        if self._last[ImuSample][0] != before.t_ns or stamps[1] < arrivals.newest_ns:
            return False
        if stamps[-1] > min(received_ns) + MAX_CLOCK_LEAD_NS:  # the last stamp is the largest if they are in order
            return False
        last = sample_matrix([before]) if self._measured is None else self._measured
        return _are_consistent(np.array(stamps), last, measured)

    def record_last(self, sample: ImuSample, received_ns: int, measured: Array) -> None:
        """Store the last sample of those that ``accepts_all`` has accepted.

        Parameters
        ----------
        sample : inertial sample.
        received_ns : time of its arrival (ns).
        measured : (1, 6) its angular rate (rad/s) and specific force (m/s2), body axes.
        """
        self._sample, self._last[ImuSample] = sample, (sample.t_ns, _READINGS[ImuSample](sample))
        self._measured = measured
        self._arrivals[ImuSample] = _Arrivals(sample.t_ns, received_ns - sample.t_ns)

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
        before, self._sample, self._measured = self._sample, sample, None
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


@jit
def _are_consistent(stamps_ns: npt.NDArray[np.int64], before: Array, measured: Array) -> bool:
    """Return True if each sample (K, 6) is later than the one before it, differs from it, and does not jump.

    ``before`` (1, 6) is the sample before the first; ``stamps_ns`` (K + 1,) begin with its stamp.
    """
    for k in range(len(measured)):
        seconds = max((stamps_ns[k + 1] - stamps_ns[k]) * 1e-9, MIN_INTERVAL_S)
        last = before[0] if k == 0 else measured[k - 1]
        differs = False
        for i in range(6):
            change = abs(measured[k, i] - last[i])
            differs |= change > 0.0
            if not change <= (MAX_ANGULAR_ACCELERATION_RADPS2 if i < 3 else MAX_JERK_MPS3) * seconds:
                return False
        if stamps_ns[k + 1] <= stamps_ns[k] or not differs:
            return False
    return True


def _differs(a: Triple, b: Triple, limit: float) -> bool:
    """Return True if a component differs by more than the limit."""
    return abs(a[0] - b[0]) > limit or abs(a[1] - b[1]) > limit or abs(a[2] - b[2]) > limit
