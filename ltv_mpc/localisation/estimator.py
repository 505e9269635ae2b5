"""The estimator node: sensor messages in, one ``Estimate`` per period out.

Order   Messages are used in order of their validity times. One that is newer than the last inertial sample waits for
        the sample that covers it, which is then split there; one older than the belief, up to a second and a little,
        is used at its own time all the same (``out_of_sequence.py``). Older ones and late inertial samples are
        dropped (``imu_dropout.py``
        has what is done without them); so is a second message of one sensor and time, and what can be seen to be wrong
        by itself (``sensor_screening.py``).
Health  Every second a report on the filter and its sensors; a filter that has diverged begins anew
        (``reinitialisation.py``),
        and comes back where it was right after all (``shadow_filter.py``).
Memory  A checkpoint every 5 s, and where the vehicle goes under or comes up; given one with its first messages, a node
        goes on from there (``warm_restart.py``) where one that is started anew has to wait for satellites.
Output  An estimate of t_ns = k x period holds everything measured up to and at t_ns that has come: it is published as
        soon as all that the sensors file has due at t_ns without latency is there, at the latest when time goes on.
        What comes later corrects the next one; nothing is published twice.
"""

from __future__ import annotations

import bisect
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation import imu_dropout
from ltv_mpc.localisation.adaptive.process_noise import Change
from ltv_mpc.localisation.checkpoint import belief_of, checkpoint_of, settings_of
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.alignment import Alignment
from ltv_mpc.localisation.filter.error_state_filter import Aiding, Filter
from ltv_mpc.localisation.filter.preintegration import readings
from ltv_mpc.localisation.filter.state import Belief, grid
from ltv_mpc.localisation.health import Monitor, verdict_of
from ltv_mpc.localisation.out_of_sequence import History, spacing_ns
from ltv_mpc.localisation.publishing import estimate
from ltv_mpc.localisation.reinitialisation import GRACE_NS, Restarts, finite, usable
from ltv_mpc.localisation.sensor_config import Adcp, BottomTracking, Compass, Gnss, Pressure, Suite, Tdcp
from ltv_mpc.localisation.sensor_screening import Door
from ltv_mpc.localisation.shadow_filter import Former
from ltv_mpc.localisation.warm_restart import Resumption
from ltv_mpc.messages import (
    AdcpPing,
    BottomTrack,
    CompassHeading,
    Estimate,
    EstimatorState,
    FilterStatus,
    GnssFix,
    ImuSample,
    LblRange,
    LocalisationReport,
    Message,
    PressureDepth,
    TdcpFix,
    UsblFix,
)
from ltv_mpc.node import Due, Inbox, OnMessage, Progress, no_progress

SENSORS: dict[type[Message], str] = {
    ImuSample: "imu",
    GnssFix: "gnss",
    TdcpFix: "tdcp",
    AdcpPing: "adcp",
    PressureDepth: "pressure",
    CompassHeading: "compass",
    BottomTrack: "bottom_track",
    LblRange: "lbl",
    UsblFix: "usbl",
}
"""What is read, and the name of each in the account: its table's in the sensors file."""

REPORT_NS = 1_000_000_000
CHECKPOINT_NS = 5_000_000_000
UNDER_M, UP_M = 1.0, 0.5
"""Deeper than the one it has gone under, less deep than the other it has come up."""

RECENT_NS = 2_500_000_000
"""What is kept for a filter that begins anew: two headings, if they come once a second."""

_MOST_RECENT = 6000
"""Messages kept: an inertial unit at 1 kHz and the others; a bound for when there is none."""

_MOST_WAITING = 1000
"""Messages that wait for an inertial sample; beyond, the oldest is dropped: the unit has failed."""


class Estimator:
    """ADCP-aided localisation as a node."""

    name = "estimator"
    schedule = OnMessage(tuple(SENSORS))
    reads: tuple[type[Message], ...] = tuple(SENSORS)
    writes: tuple[type[Message], ...] = (Estimate, LocalisationReport, EstimatorState)

    def __init__(
        self,
        suite: Suite,
        config: EstimatorConfig,
        prior: WaterPrior | None = None,
        *,
        progress: Progress = no_progress,
    ) -> None:
        """``prior``: of the water, from an earlier dive; None: that of the settings."""
        self._suite = suite
        self._progress = progress
        self._period_ns = config.estimate_period_ns
        self._config = config
        self._depth_m = grid(config)
        self._prior = prior
        self._settings = settings_of(suite, config, prior)
        self._alignment: Alignment | Resumption = Alignment(suite, config, prior)
        self._filter: Filter | None = None
        self._history: History | None = None  # of the filter
        self._waiting: list[Aiding] = []  # for the inertial sample that covers them, by time, then arrival
        self._next_ns = 0  # of the estimate to come
        self._awaited: list[type[Message]] = []  # due at this instant and not here yet, while its estimate is open
        self._open = False  # this instant's estimate is still to be published
        self._account: Counter[str] = Counter()  # of the node, and of filters that are no more
        self._door = Door()
        self._monitor = Monitor(suite, config.gate_probability)
        self._restarts = Restarts(suite, config, prior)
        self._recent: deque[ImuSample | Aiding] = deque(maxlen=_MOST_RECENT)
        self._anew: Alignment | None = None  # of the filter that is to take the diverged one's place
        self._former: Former | None = None  # as the filter was when it began to be doubted
        self._returned_ns: int | None = None  # when that came back
        self._report_ns = 0  # of the report to come
        self._checkpoint_ns = 0  # of the checkpoint to come
        self._under = False  # water
        self._resumed_ns: int | None = None  # when it went on from a checkpoint

    @property
    def filter(self) -> Filter | None:
        """None until it is aligned."""
        return self._filter

    @property
    def waiting_for(self) -> str:
        """Sensors without which it cannot start, in words; empty once it runs."""
        return self._alignment.waiting_for if self._filter is None else ""

    @property
    def account(self) -> Mapping[str, int]:
        """How many by "<sensor>.<what came of them>".

        Scalar measurements: used, doubted (of these), gate, not_definite, no_return, outside_grid, other_epoch,
        not_fitted, unknown_transponder. Messages: late, late_applied, duplicate, ahead, stale, stuck, wild,
        without_imu, gap.
        """
        if self._filter is None:
            return self._account
        account = Counter(self._account)
        account.update(self._filter.account)
        return account

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Use every message of each inbox in its order, by its own time.

        Inertial samples between which nothing else happens are integrated at once.
        """
        if len(due) == 1:  # as in a process, where looking for several costs more than it saves
            return [self._step(due[0][1])]
        signals: list[list[Message]] = []
        while (first := len(signals)) < len(due):
            signals += self._go_through(due, first) or [self._step(due[first][1])]
        return signals

    def _step(self, inbox: Inbox) -> list[Message]:
        """Use every message of the inbox in its order."""
        out: list[Message] = []
        for arrival in inbox:
            signal: Any = arrival.signal
            sensor = SENSORS.get(type(signal))  # a tenth of the time of isinstance() of nine types
            if sensor is not None:
                why = self._door.refusal(signal.t_ns, signal, arrival.received_t_ns)
                if why is None:
                    self._take(signal, out)
                else:
                    self._account[f"{sensor}.{why}"] += 1
            elif isinstance(signal, EstimatorState):
                self._restore(signal)
        return out

    def _go_through(self, due: Sequence[Due], first: int) -> list[list[Message]]:
        """What is said at those of them, from ``first`` on, that were samples which only had to be integrated, at most
        up to the next estimate; empty where there are none.
        """
        history = self._history
        busy = self._open or self._waiting or self._anew is not None or self._former is not None
        if history is None or busy:
            return []
        samples: list[ImuSample] = []
        received_ns: list[int] = []
        next_ns = self._next_ns
        for _, inbox in islice(due, first, None):
            sample = inbox[0].signal
            if len(inbox) != 1 or type(sample) is not ImuSample or sample.t_ns > next_ns:
                break
            samples.append(sample)
            received_ns.append(inbox[0].received_t_ns)
        if not samples or not finite(history.filter.belief):
            return []
        number = history.follows(samples)
        if not number:
            return []
        samples = samples[:number]
        measured = readings(samples)
        if not self._door.lets_through(samples, received_ns[:number], measured):
            return []
        number = history.advance_through(samples, measured)
        self._door.let_through(samples[number - 1], received_ns[number - 1], measured[number - 1 : number])
        self._remember(samples[:number])
        signals: list[list[Message]] = [[] for _ in range(number)]
        self._reach(samples[number - 1].t_ns)
        if self._open and not self._awaited:
            self._publish(history.filter, signals[-1])
        self._used(history)
        return signals

    def _restore(self, state: EstimatorState) -> None:
        """Continue from the state of another process of this node, unless this one has a filter already."""
        if self._filter is not None:
            return
        belief = belief_of(state, self._suite, self._config, self._prior)
        if belief is None:
            self._account["checkpoint.of_other_settings"] += 1
            return
        self._alignment = Resumption(self._suite, self._config, belief, state.estimate)
        self._restarts.count = state.restarts

    def _take(self, message: ImuSample | Aiding, out: list[Message]) -> None:
        if self._history is not None:
            self._use(self._history, message, out)
            return
        self._alignment.take(message)
        if self._alignment.waiting_for:
            return
        belief, since = self._alignment.belief()
        self._next_ns = (belief.t_ns // self._period_ns + 1) * self._period_ns
        self._report_ns = (belief.t_ns // REPORT_NS + 1) * REPORT_NS
        self._under = float(belief.x[2]) > UNDER_M
        self._checkpoint_ns = belief.t_ns
        if isinstance(self._alignment, Resumption):
            self._resumed_ns = belief.t_ns
        history = self._begin(belief)
        for earlier in since:
            self._use(history, earlier, out)

    def _begin(self, belief: Belief, adapts_from_ns: int | None = None) -> History:
        """A filter of its own from here on."""
        return self._go_on(Filter(self._suite, self._config, belief, adapts_from_ns=adapts_from_ns))

    def _go_on(self, filter_: Filter) -> History:
        """With this one."""
        self._filter = filter_
        filter_.observers[:] = [self._monitor.hear]
        self._history = History(filter_, spacing_ns(self._suite), self._progress)
        return self._history

    def _use(self, history: History, message: ImuSample | Aiding, out: list[Message]) -> None:
        self._remember([message])
        if self._anew is not None:
            self._anew.take(message)
        self._apply(history, message, out)
        self._used(history)

    def _remember(self, messages: Sequence[ImuSample | Aiding]) -> None:
        """For a filter that begins anew."""
        self._recent.extend(messages)
        newest = messages[-1]
        if isinstance(newest, ImuSample):
            while self._recent[0].t_ns < newest.t_ns - RECENT_NS:
                self._recent.popleft()

    def _used(self, history: History) -> None:
        """What there is to look after when messages have been used."""
        if self._anew is None and not finite(history.filter.belief) and self._restarts.knows_a_place:
            self._anew = self._restarts.begin(history.filter.belief.t_ns, self._recent)
        if self._anew is not None and not self._anew.waiting_for:
            history = self._replace(history.filter, self._anew)
        if self._former is not None:
            self._look_back(history.filter, self._former)

    def _replace(self, old: Filter, alignment: Alignment) -> History:
        """The new filter takes over, at the time that the old one has reached; nothing is published on the way."""
        self._anew = None
        former, self._former = self._former, None  # has had all of it
        self._account.update(old.account)
        self._monitor.forget()
        belief, since = alignment.belief()
        # Where the prior of the water is wide again, what moves past is not taken for a front until it has settled.
        history = self._begin(belief, None if self._restarts.graft(belief) else belief.t_ns + GRACE_NS)
        next_ns, open_, self._open = self._next_ns, self._open, False
        for earlier in since:
            if earlier.t_ns <= old.belief.t_ns:
                self._apply(history, earlier, [])
        self._next_ns, self._open = next_ns, open_
        history.filter.account.clear()  # counted when the old filter used it
        self._former = former
        return history

    def _look_back(self, current: Filter, former: Former) -> None:
        """The filter from before the doubt is believed again once what it refused agrees with it, or forgotten."""
        t_ns = current.belief.t_ns
        in_doubt = self._restarts.doubts or self._restarts.recent(t_ns)
        if former.expired or not finite(former.filter.belief) or (former.agrees and not in_doubt):
            self._former = None
        elif former.agrees and former.is_worth_more(current):
            self._former = self._anew = None
            self._account.update(current.account)
            self._monitor.forget()
            former.filter.account.clear()  # counted by the one in its place
            former.filter.water.forget(former.filter.belief)
            self._go_on(former.filter)
            self._restarts.recall(former.memory)
            self._returned_ns = t_ns

    def _apply(self, history: History, message: ImuSample | Aiding, out: list[Message]) -> None:
        if isinstance(message, ImuSample):
            self._move(history, message, out)
            return
        now_ns, sensor = history.filter.belief.t_ns, SENSORS[type(message)]
        if message.t_ns > now_ns:
            bisect.insort(self._waiting, message, key=lambda m: m.t_ns)
            if len(self._waiting) > _MOST_WAITING:
                self._account[f"{SENSORS[type(self._waiting.pop(0))]}.without_imu"] += 1
        elif message.t_ns == now_ns:
            self._correct(history, message, out)
        elif not history.reaches(message.t_ns):
            self._account[f"{sensor}.late"] += 1
        elif history.knows(message):
            self._account[f"{sensor}.duplicate"] += 1
        elif finite(history.filter.belief):
            self._heed(history, message)
            self._account[f"{sensor}.late_applied"] += 1

    def _move(self, history: History, sample: ImuSample, out: list[Message]) -> None:
        """Advance to the sample's time, by way of every message and every estimate that falls within."""
        filter_ = history.filter
        if sample.t_ns <= filter_.belief.t_ns:
            self._account["imu.late"] += 1
            return
        if imu_dropout.before(sample, filter_.belief.t_ns):
            self._account["imu.gap"] += 1
        while filter_.belief.t_ns < sample.t_ns:
            stop_ns = min(sample.t_ns, self._next_ns)
            if self._waiting:
                stop_ns = min(stop_ns, self._waiting[0].t_ns)
            self._publish(filter_, out)
            history.advance(stop_ns, sample)
            if self._former is not None:
                self._former.advance(stop_ns, sample)
            self._reach(stop_ns)
            while self._waiting and self._waiting[0].t_ns == stop_ns:
                self._correct(history, self._waiting.pop(0), out)
            if self._open and not self._awaited:
                self._publish(filter_, out)

    def _reach(self, t_ns: int) -> None:
        """The filter has come to this instant; an estimate of it is open until all that is due then is here."""
        if t_ns == self._next_ns:
            self._open = True
            self._next_ns += self._period_ns
            self._awaited = self._due(t_ns)

    def _due(self, t_ns: int) -> list[type[Message]]:
        """What the sensors file has at ``t_ns`` and at once; satellites only until the descent begins, at 0."""
        s = self._suite
        tables: list[tuple[type[Message], Gnss | Tdcp | Adcp | Pressure | Compass | BottomTracking]] = [
            (AdcpPing, s.adcp),
            (PressureDepth, s.pressure),
            (CompassHeading, s.compass),
        ]
        if s.bottom_track is not None:
            tables.append((BottomTrack, s.bottom_track))
        if t_ns <= 0:
            tables += [(GnssFix, s.gnss), (TdcpFix, s.tdcp)]
        return [kind for kind, table in tables if table.latency_ns == 0 and t_ns % table.period_ns == 0]

    def _correct(self, history: History, message: Aiding, out: list[Message]) -> None:
        if history.knows(message):
            self._account[f"{SENSORS[type(message)]}.duplicate"] += 1
            return
        if finite(history.filter.belief):
            self._heed(history, message)
        if self._open:
            if type(message) in self._awaited:
                self._awaited.remove(type(message))
            if not self._awaited:
                self._publish(history.filter, out)

    def _heed(self, history: History, message: Aiding) -> None:
        """Correct by it, now or at its own time, and let the water adapt to a ping."""
        history.use(message)
        if isinstance(message, AdcpPing):
            history.adapt()
        if self._former is not None:
            self._former.use(message)

    def _publish(self, filter_: Filter, out: list[Message]) -> None:
        if self._open:
            self._open = False
            out.append(estimate(filter_, self._depth_m))
            if filter_.belief.t_ns >= self._report_ns:
                out.append(self._report(filter_))
            if self._is_checkpoint_due(filter_.belief):
                out.append(checkpoint_of(filter_, self._settings, self._restarts.count))

    def _is_checkpoint_due(self, belief: Belief) -> bool:
        """What is doubted is not worth going on from."""
        depth_m = float(belief.x[2])
        turned = depth_m < UP_M if self._under else depth_m > UNDER_M
        due = (turned or belief.t_ns >= self._checkpoint_ns) and not self._restarts.doubts and usable(belief)
        if due:
            self._under ^= turned
            self._checkpoint_ns = (belief.t_ns // CHECKPOINT_NS + 1) * CHECKPOINT_NS
        return due

    def _report(self, filter_: Filter) -> LocalisationReport:
        """Of this second; begins a restart where the filter has diverged."""
        t_ns = filter_.belief.t_ns
        self._report_ns = (t_ns // REPORT_NS + 1) * REPORT_NS
        sensors = self._monitor.sensors(t_ns, self.account)
        status, why = verdict_of(sensors)
        walk = filter_.water.walk_mps_per_rts(t_ns)
        if filter_.water.beyond(t_ns) and status is FilterStatus.NOMINAL:
            status, why = FilterStatus.INCONSISTENT, "adcp: water moves past the vehicle as no water does"
        if self._anew is None and self._restarts.watch(filter_.belief, status, broken=self._monitor.broken):
            self._anew = self._restarts.begin(t_ns, self._recent)
        elif self._restarts.began_to_doubt(t_ns) and self._former is None:
            self._former = Former(filter_, spacing_ns(self._suite), self._restarts.memory())
        elif self._restarts.is_belief_due(t_ns) and usable(filter_.belief):
            self._restarts.keep(filter_.settled())
        if self._resumed_ns is not None and t_ns - self._resumed_ns < GRACE_NS:
            status, why = FilterStatus.RESTARTED, why or "went on from a checkpoint"
        elif self._returned_ns is not None and t_ns - self._returned_ns < GRACE_NS:
            status, why = FilterStatus.RESTARTED, why or "went back to what it was before it was doubted"
        elif self._restarts.recent(t_ns):
            status, why = FilterStatus.RESTARTED, why or "began anew from its last good position"
        elif status is FilterStatus.NOMINAL and walk > 0.0:
            status, why = FilterStatus.UNFORESEEN, f"water that changes: granted {1e3 * walk:.2g} mm/s per sqrt(s)"
            if filter_.water.change(t_ns) is Change.UNIT:
                why = "water that changes for longer than a front, or a gyro's fault: both are allowed for"
        return LocalisationReport(
            t_ns=t_ns,
            status=status,
            why=why,
            restarts=self._restarts.count,
            water_walk_mps_per_rts=walk,
            sensors=sensors,
        )
