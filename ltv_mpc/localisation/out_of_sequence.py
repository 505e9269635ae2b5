"""Out-of-sequence measurements: the filter returns to the time of a late measurement and repeats its work since.

Buffer  snapshots of the filter, and after each the operations on it, over the last ``REACH_NS``:
            snapshot_0, operation, operation, ..., snapshot_1, operation, ...
        An operation is a propagation by a sample, or a correction.
Late    The newest snapshot at or before the message's time is restored, and its successors are dropped. The operations
        since are repeated: the message follows all those of its own instant, the propagation across its time is split
        there, and new snapshots are taken on the way. The same messages cause these operations if they arrive in order,
        so the belief is the same bit for bit.
Counts  Every measurement is counted and observed once. A repeated correction is neither counted nor observed, although
        the gate may now decide differently.
Cost    A snapshot copies the covariance. A late message repeats the filter's work since the snapshot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from ltv_mpc.localisation.adaptive.process_noise import BACK_NS, NoiseLevel
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter, FilterState
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.messages import ImuSample
from ltv_mpc.node import Progress, no_progress

REACH_NS = 1_250_000_000
"""Maximum age of a measurement: the longest latency that a sensors file may have, and a quarter for the bus."""

SPACING_NS = 250_000_000
"""Time between two snapshots."""


class Operation(NamedTuple):
    """Propagation to ``t_ns`` by a sample, or correction at ``t_ns`` by a measurement."""

    t_ns: int
    message: ImuSample | Measurement


class _Segment(NamedTuple):
    """Snapshot, and the operations up to the next one."""

    snapshot: FilterState
    operations: list[Operation]

    @property
    def t_ns(self) -> int:
        """Time of the snapshot (ns)."""
        return self.snapshot.belief.t_ns


def is_duplicate(first: ImuSample | Measurement, second: ImuSample | Measurement) -> bool:
    """Return True if two messages have the same sensor, source and validity time.

    Parameters
    ----------
    first, second : messages of any sensors.
    """
    if type(first) is not type(second) or first.t_ns != second.t_ns:
        return False
    source = BY_MESSAGE[type(first)].source
    return source is None or bool(source(first) == source(second))


class MeasurementBuffer:
    """Buffer of a filter's past, by which late measurements correct it at their own time."""

    def __init__(self, filter_: ErrorStateFilter, progress: Progress = no_progress) -> None:
        """Create a buffer that begins at the filter's time.

        Parameters
        ----------
        filter_ : filter to propagate and to correct.
        progress : called with every propagation, as a sign of life; a late message may need a thousand.
        """
        self.filter = filter_
        self._progress = progress
        self._segments = [_Segment(filter_.snapshot(), [])]

    def advance(self, t_ns: int, sample: ImuSample) -> None:
        """Propagate the filter (``ErrorStateFilter.advance``), and take a snapshot if one is due.

        Parameters
        ----------
        t_ns : time to propagate to (ns).
        sample : inertial sample that covers this time.
        """
        now_ns = self.filter.belief.t_ns
        segments = self._segments
        # A snapshot is taken when the filter leaves an instant: it then holds all corrections of that instant.
        if now_ns - segments[-1].t_ns >= SPACING_NS:
            segments.append(_Segment(self.filter.snapshot(), []))
            while len(segments) > 1 and segments[1].t_ns <= now_ns - BACK_NS:
                del segments[0]
        self._progress()
        self.filter.advance(t_ns, sample)
        segments[-1].operations.append(Operation(t_ns, sample))

    def correct(self, message: Measurement) -> None:
        """Correct the filter by a measurement of its own instant (``ErrorStateFilter.correct``).

        Parameters
        ----------
        message : measurement of the filter's time.
        """
        self.filter.correct(message)
        self._segments[-1].operations.append(Operation(message.t_ns, message))

    def use(self, message: Measurement) -> None:
        """Correct the filter by a measurement of its own instant, or of an earlier one within reach.

        Parameters
        ----------
        message : measurement of the filter's time, or of one within reach.
        """
        if message.t_ns == self.filter.belief.t_ns:
            self.correct(message)
        else:
            self.insert(message)

    def contains(self, message: Measurement) -> bool:
        """Return True if a measurement of the same sensor, source and time has been used.

        Parameters
        ----------
        message : measurement of any time.
        """
        for segment in reversed(self._segments):
            for operation in reversed(segment.operations):
                if operation.t_ns < message.t_ns:
                    return False
                if is_duplicate(operation.message, message):
                    return True
        return False

    def is_within_reach(self, t_ns: int) -> bool:
        """Return True if a measurement of an earlier time can still be used.

        The oldest instant is out of reach, because the operations before its snapshot are not known.

        Parameters
        ----------
        t_ns : validity time of the measurement, before the filter's time (ns).
        """
        return t_ns >= self.filter.belief.t_ns - REACH_NS and t_ns > self._segments[0].t_ns

    def insert(self, message: Measurement) -> None:
        """Correct the filter at an earlier time within reach, and repeat the operations since.

        Parameters
        ----------
        message : measurement of an earlier time within reach.
        """
        segments = self._segments
        first = max(i for i, segment in enumerate(segments) if segment.t_ns <= message.t_ns)
        since = [operation for segment in segments[first:] for operation in segment.operations]
        del segments[first + 1 :]
        segments[first].operations.clear()
        self.filter.restore(segments[first].snapshot)

        # A later time is reached by propagation alone.
        after = next(i for i, operation in enumerate(since) if operation.t_ns > message.t_ns)
        with _without_counting(self.filter):
            self._repeat(since[:after])
        across = since[after].message
        if self.filter.belief.t_ns < message.t_ns and isinstance(across, ImuSample):
            self.advance(message.t_ns, across)
        self.correct(message)
        with _without_counting(self.filter):
            self._repeat(since[after:])

    def adapt(self) -> NoiseLevel:
        """Adapt the process noise of the water to the change that the last ping has shown.

        The noise is inflated from ``BACK_NS`` ago on, or from the oldest snapshot, and the operations since are
        repeated. If the change began before that, its effect on the belief is compensated instead, and the buffer
        begins again at the present: no later measurement reaches behind it.

        Returns
        -------
        The level that the noise has been inflated to; ``NONE`` if nothing has changed.
        """
        filter_ = self.filter
        noise, belief = filter_.process_noise, filter_.belief
        now_ns = belief.t_ns
        onset = noise.detect_onset(belief)
        if onset is not None and onset.is_old:
            onset.compensate(belief)
            noise.reset_tests(belief)
            noise.inflate(NoiseLevel.FAST, noise.inflation_end_ns(NoiseLevel.FAST, now_ns), now_ns)
            self._segments[:] = [_Segment(filter_.snapshot(), [])]
            return NoiseLevel.FAST
        level = noise.required_level(now_ns, onset)
        if level is not NoiseLevel.NONE:
            until_ns = noise.inflation_end_ns(level, now_ns)
            first = max((i for i, s in enumerate(self._segments) if s.t_ns <= now_ns - BACK_NS), default=0)
            since = [operation for segment in self._segments[first:] for operation in segment.operations]
            filter_.restore(self._segments[first].snapshot)
            filter_.process_noise.inflate(level, until_ns, now_ns)
            self._segments[first:] = [_Segment(filter_.snapshot(), [])]
            with _without_counting(filter_):
                self._repeat(since)
        return level

    def _repeat(self, operations: list[Operation]) -> None:
        for t_ns, message in operations:
            if isinstance(message, ImuSample):
                self.advance(t_ns, message)
            else:
                self.correct(message)


@contextmanager
def _without_counting(filter_: ErrorStateFilter) -> Iterator[None]:
    """Suspend the account and the observers of a filter."""
    account, observers = filter_.account, filter_.observers
    filter_.account, filter_.observers = Counter(), []
    try:
        yield
    finally:
        filter_.account, filter_.observers = account, observers
