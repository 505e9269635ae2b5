"""Sensor screening: reject measurements that are implausible by themselves, before the filter uses them.

ahead  stamped later than it came: a clock has jumped. A belief that had followed it would refuse all true ones after it
       as late.
stale  stamped earlier than another of its instrument before it, and so much longer on its way than that one: they came
       in order, so a clock has jumped back. So are those after it, until one takes no longer than usual: when their
       stamps have caught up with the belief's, what they say is of now, not of then. (What was held up by a bus and
       comes after newer ones is given up with them. Ranges of several transponders come in any order.)
stuck  the same reading as the last, to the bit, at another time: every instrument has noise, this one repeats itself.
       Taken for new, a position with its noise would be believed more with each repetition. One number alone, as a
       depth, may come twice by rounding; for several at once that is next to impossible.
wild   an inertial sample that differs from the one before by more than a vehicle can do in between, 0.2 rad/s and
       2 m/s2 every 10 ms; and after it all until ``MIN_CONSISTENT`` in a row do follow one another.
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
"""The clocks of two computers may differ by some of it."""

MAX_ANGULAR_ACCELERATION_RADPS2, MAX_JERK_MPS3 = 20.0, 200.0
MIN_INTERVAL_S = 0.01
"""For so long at least: faster units too see vibration."""

MIN_CONSISTENT = 5

_READINGS: Mapping[type[Message], Callable[[Any], object]] = {
    sensor.message: sensor.reading for sensor in SENSORS if sensor.reading is not None
}
_IN_ORDER: frozenset[type[Message]] = frozenset(sensor.message for sensor in SENSORS if sensor.source is None)
"""Messages that arrive in order of their validity times, because they have a single source."""


@dataclass(slots=True)
class _Way:
    """Of one instrument: stamp of the newest message, how long that took, whether one stamped earlier came since."""

    newest_ns: int
    took_ns: int
    back: bool = False


class SensorScreening:
    """Of one estimator; it remembers the last reading of each instrument."""

    def __init__(self) -> None:
        self._last: dict[type[Message], tuple[int, object]] = {}
        self._sample: ImuSample | None = None
        self._measured: Array | None = None  # of that sample, (1, 6), where it was one of many
        self._to_agree = 0
        self._ways: dict[type[Message], _Way] = {}

    def rejection(self, t_ns: int, message: Message, received_ns: int) -> str | None:
        """Why a message of time ``t_ns`` that came at ``received_ns`` is not used: a word of the account, or None."""
        if t_ns > received_ns + MAX_CLOCK_LEAD_NS:
            return "future"
        kind = type(message)
        if kind in _IN_ORDER and self._went_back(kind, t_ns, received_ns):
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
        """Whether inertial samples, ``measured`` (K, 6), would all be let in, as far as a quick look can tell."""
        way, before = self._ways.get(ImuSample), self._sample
        if way is None or way.back or before is None or self._to_agree:
            return False
        stamps = [before.t_ns, *[sample.t_ns for sample in samples]]
        if self._last[ImuSample][0] != before.t_ns or stamps[1] < way.newest_ns:
            return False
        if stamps[-1] > min(received_ns) + MAX_CLOCK_LEAD_NS:  # which all are before, if they are in order
            return False
        last = sample_matrix([before]) if self._measured is None else self._measured
        return _follow_one_another(np.array(stamps), last, measured)

    def record_last(self, sample: ImuSample, received_ns: int, measured: Array) -> None:
        """The last of those that were; ``measured`` (1, 6)."""
        self._sample, self._last[ImuSample] = sample, (sample.t_ns, _READINGS[ImuSample](sample))
        self._measured = measured
        self._ways[ImuSample] = _Way(sample.t_ns, received_ns - sample.t_ns)

    def _went_back(self, kind: type[Message], t_ns: int, received_ns: int) -> bool:
        took_ns = received_ns - t_ns
        way = self._ways.get(kind)
        if way is None:
            self._ways[kind] = _Way(t_ns, took_ns)
            return False
        way.back = way.back or t_ns < way.newest_ns - MAX_CLOCK_LEAD_NS
        if way.back and took_ns > way.took_ns + MAX_CLOCK_LEAD_NS:
            return True
        if t_ns >= way.newest_ns:
            way.newest_ns, way.took_ns, way.back = t_ns, took_ns, False
        return False

    def _jumps(self, sample: ImuSample) -> bool:
        before, self._sample, self._measured = self._sample, sample, None
        if before is None or before.t_ns == sample.t_ns:
            return False
        seconds = max(abs(sample.t_ns - before.t_ns) * 1e-9, MIN_INTERVAL_S)
        turned = _apart(sample.angular_rate_radps, before.angular_rate_radps, MAX_ANGULAR_ACCELERATION_RADPS2 * seconds)
        if turned or _apart(sample.specific_force_mps2, before.specific_force_mps2, MAX_JERK_MPS3 * seconds):
            self._to_agree = MIN_CONSISTENT
        elif self._to_agree:
            self._to_agree -= 1
        return self._to_agree > 0


@jit
def _follow_one_another(stamps_ns: npt.NDArray[np.int64], before: Array, measured: Array) -> bool:
    """Each sample (K, 6) after ``before`` (1, 6) is later, differs, and by no more than a vehicle can do in between."""
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


def _apart(a: Triple, b: Triple, most: float) -> bool:
    """They differ by more in a part."""
    return abs(a[0] - b[0]) > most or abs(a[1] - b[1]) > most or abs(a[2] - b[2]) > most
