"""Measurements that arrive after their time: the filter goes back to it and does everything since once more.

Kept    snapshots of the filter, and after each what was done to it, over the last ``REACH_NS``:
            snapshot_0, done, done, ..., snapshot_1, done, ...      done: a move by a sample, or a correction
Late    the newest snapshot at or before the message's time is restored, its successors are forgotten; what follows is
        done again, the message after all that is of its own instant, the move across its time split there, and new
        snapshots are taken on the way. These are the operations that the same messages cause in order, one by one, so
        the belief is the same bit for bit.
Said    once: what was judged when it came is corrected with again but not counted or observed again, though the gate
        may decide differently now. Only the late message itself is heard.
Cost    A snapshot copies the covariance, a late message repeats as much of the filter's work as lies between the
        snapshot and now: the copying falls with the spacing, the repeating grows by half of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from ltv_mpc.localisation.adaptive.process_noise import BACK_NS, NoiseLevel
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter, Snapshot
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_MESSAGE, fitted
from ltv_mpc.localisation.sensors.sensor import Availability, Measurement
from ltv_mpc.localisation.sensors.settings import latency_ns
from ltv_mpc.messages import Array, ImuSample
from ltv_mpc.node import Progress, no_progress

REACH_NS = 1_250_000_000
"""A message that is later is dropped: the longest latency that a sensors file may have, and a quarter for the bus."""

_OFTEN_NS = 250_000_000
_SELDOM_NS = 1_000_000_000


class Done(NamedTuple):
    """Moved to ``t_ns`` by a sample, or corrected there."""

    t_ns: int
    what: ImuSample | Measurement


class _Segment(NamedTuple):
    """From a snapshot to the next one."""

    snapshot: Snapshot
    done: list[Done]

    @property
    def t_ns(self) -> int:
        return self.snapshot.belief.t_ns


def is_duplicate(one: ImuSample | Measurement, other: ImuSample | Measurement) -> bool:
    """Two messages of one sensor and time, of which the second says nothing new."""
    if type(one) is not type(other) or one.t_ns != other.t_ns:
        return False
    source = BY_MESSAGE[type(one)].source
    return source is None or bool(source(one) == source(other))


def snapshot_spacing_ns(suite: SensorConfig) -> int:
    """Between two snapshots: longer where only a bus makes messages late."""
    late = any(
        sensor.availability is Availability.INTERMITTENT or latency_ns(settings) != 0
        for sensor, settings in fitted(suite)
    )
    return _OFTEN_NS if late else _SELDOM_NS


class MeasurementBuffer:
    """Moves and corrects a filter, and can do so in the past."""

    def __init__(self, filter_: ErrorStateFilter, spacing_ns: int, progress: Progress = no_progress) -> None:
        """``progress`` is called with every move, of which a way back may take a thousand."""
        self.filter = filter_
        self._progress = progress
        self._spacing_ns = spacing_ns
        self._segments = [_Segment(filter_.snapshot(), [])]

    def advance(self, t_ns: int, sample: ImuSample) -> None:
        """As ``ErrorStateFilter.advance``."""
        now_ns = self.filter.belief.t_ns
        segments = self._segments
        # Taken on leaving an instant: it then holds all corrections of it.
        if now_ns - segments[-1].t_ns >= self._spacing_ns:
            segments.append(_Segment(self.filter.snapshot(), []))
            while len(segments) > 1 and segments[1].t_ns <= now_ns - BACK_NS:
                del segments[0]
        self._progress()
        self.filter.advance(t_ns, sample)
        segments[-1].done.append(Done(t_ns, sample))

    def count_contiguous(self, samples: Sequence[ImuSample]) -> int:
        """As ``ErrorStateFilter.count_contiguous``, until a snapshot is to be taken."""
        return self.filter.count_contiguous(samples, self._segments[-1].t_ns + self._spacing_ns)

    def advance_batch(self, samples: Sequence[ImuSample], measured: Array) -> int:
        """As ``ErrorStateFilter.advance_batch``."""
        self._progress()
        done = self.filter.advance_batch(samples, measured)
        self._segments[-1].done.extend([Done(sample.t_ns, sample) for sample in samples[:done]])
        return done

    def correct(self, message: Measurement) -> None:
        """As ``ErrorStateFilter.correct``: of the filter's own instant."""
        self.filter.correct(message)
        self._segments[-1].done.append(Done(message.t_ns, message))

    def use(self, message: Measurement) -> None:
        """Correct by a message of the filter's own instant, or of one before it within reach."""
        if message.t_ns == self.filter.belief.t_ns:
            self.correct(message)
        else:
            self.insert(message)

    def contains(self, message: Measurement) -> bool:
        """One of its kind and time has been used."""
        for segment in reversed(self._segments):
            for done in reversed(segment.done):
                if done.t_ns < message.t_ns:
                    return False
                if is_duplicate(done.what, message):
                    return True
        return False

    def is_within_reach(self, t_ns: int) -> bool:
        """A message of this time, before the filter's, can still be used. Of the oldest instant nothing is known."""
        return t_ns >= self.filter.belief.t_ns - REACH_NS and t_ns > self._segments[0].t_ns

    def insert(self, message: Measurement) -> None:
        """Correct by a message of a time before the filter's, within reach."""
        segments = self._segments
        first = max(i for i, segment in enumerate(segments) if segment.t_ns <= message.t_ns)
        again = [done for segment in segments[first:] for done in segment.done]
        del segments[first + 1 :]
        segments[first].done.clear()
        self.filter.restore(segments[first].snapshot)

        after = next(i for i, done in enumerate(again) if done.t_ns > message.t_ns)  # a move: only they pass time
        with _uncounted(self.filter):
            self._repeat(again[:after])
        across = again[after].what
        if self.filter.belief.t_ns < message.t_ns and isinstance(across, ImuSample):
            self.advance(message.t_ns, across)
        self.correct(message)
        with _uncounted(self.filter):
            self._repeat(again[after:])

    def adapt(self) -> NoiseLevel:
        """Grant the water what the last ping showed that it needs, from ``BACK_NS`` ago, or as far as it reaches; or
        make up for what it has done, from now on: behind this nothing goes back.
        """
        filter_ = self.filter
        water, belief = filter_.process_noise, filter_.belief
        now_ns = belief.t_ns
        began = water.detect_onset(belief)
        if began is not None and began.is_old:
            began.compensate(belief)
            water.reset_tests(belief)
            water.inflate(NoiseLevel.FAST, water.inflation_end_ns(NoiseLevel.FAST, now_ns), now_ns)
            self._segments[:] = [_Segment(filter_.snapshot(), [])]
            return NoiseLevel.FAST
        change = water.required_level(now_ns, began)
        if change is not NoiseLevel.NONE:
            until_ns = water.inflation_end_ns(change, now_ns)
            first = max((i for i, s in enumerate(self._segments) if s.t_ns <= now_ns - BACK_NS), default=0)
            again = [done for segment in self._segments[first:] for done in segment.done]
            filter_.restore(self._segments[first].snapshot)
            filter_.process_noise.inflate(change, until_ns, now_ns)
            self._segments[first:] = [_Segment(filter_.snapshot(), [])]
            with _uncounted(filter_):
                self._repeat(again)
        return change

    def _repeat(self, again: list[Done]) -> None:
        for t_ns, what in again:
            if isinstance(what, ImuSample):
                self.advance(t_ns, what)
            else:
                self.correct(what)


@contextmanager
def _uncounted(filter_: ErrorStateFilter) -> Iterator[None]:
    """What the filter does within is neither counted nor observed."""
    account, observers = filter_.account, filter_.observers
    filter_.account, filter_.observers = Counter(), []
    try:
        yield
    finally:
        filter_.account, filter_.observers = account, observers
