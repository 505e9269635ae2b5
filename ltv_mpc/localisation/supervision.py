"""Supervision of the active filter: its health, its reinitialisation and its shadow.

Health            Once a second a report judges the filter by the innovations of its sensors (``health.py``).
Reinitialisation  A filter that has diverged is replaced by one that starts from the last good position
                  (``reinitialisation.py``). It takes over at the time that the old filter has reached.
Shadow filter     A copy is taken when innovations first become inconsistent. It replaces the active filter if the
                  sensors agree with the copy again (``shadow_filter.py``).
Warm restart      A filter that continues from a checkpoint is reported as restarted for ``RESTARTED_NS``
                  (``warm_restart.py``).
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping

from ltv_mpc.currents import WaterPrior
from ltv_mpc.localisation.adaptive.process_noise import NoiseLevel
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.alignment import Alignment
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.localisation.health import HealthMonitor, InnovationSamples, filter_status
from ltv_mpc.localisation.out_of_sequence import snapshot_spacing_ns
from ltv_mpc.localisation.reinitialisation import RESTARTED_NS, Reinitialisation, is_finite, is_usable
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.localisation.sequencing import Sequencing
from ltv_mpc.localisation.shadow_filter import ShadowFilter
from ltv_mpc.messages import FilterStatus, ImuSample, LocalisationReport, SensorReport

REPORT_NS = 1_000_000_000

RECENT_NS = 2_500_000_000
"""Age up to which messages are stored for a reinitialisation: it holds two headings of a compass at 1 Hz."""

_MAX_RECENT = 6000
"""Maximum number of stored messages, for the case that the inertial unit has failed: 2.5 s of a unit at 1 kHz, and the
other sensors."""


class Supervision:
    """Judges the active filter once a second, and replaces it if it has diverged."""

    def __init__(
        self,
        sensor_config: SensorConfig,
        config: EstimatorConfig,
        prior: WaterPrior | None,
        sequencing: Sequencing,
        account: Counter[str],
    ) -> None:
        """Create a supervision without a filter.

        Parameters
        ----------
        sensor_config : settings of the sensors.
        config : settings of the filter.
        prior : water known from an earlier dive; None: that of ``config``.
        sequencing : applies messages to the active filter; a new filter is set there.
        account : counts by "<sensor>.<outcome>"; those of a replaced filter are added to it.
        """
        self._sensor_config, self._config = sensor_config, config
        self._sequencing, self._account = sequencing, account
        self._monitor = HealthMonitor(sensor_config, config.gate_probability)
        self.reinitialisation = Reinitialisation(sensor_config, config, prior)
        self._recent: deque[ImuSample | Measurement] = deque(maxlen=_MAX_RECENT)
        self._replacement: Alignment | None = None  # of the filter that will replace the diverged one
        self._shadow: ShadowFilter | None = None
        self._samples = InnovationSamples()
        self._restarted: tuple[int, str] | None = None  # time of a warm restart or shadow's takeover (ns), and why
        self.report_ns = 0  # of the next report

    def begin(self, belief: Belief, *, warm: bool) -> None:
        """Start the first filter.

        Parameters
        ----------
        belief : the aligned belief.
        warm : it continues from a checkpoint.
        """
        self.report_ns = (belief.t_ns // REPORT_NS + 1) * REPORT_NS
        if warm:
            self._restarted = belief.t_ns, "restarted from a checkpoint"
        self._set_filter(ErrorStateFilter(self._sensor_config, self._config, belief))

    def receive(self, message: ImuSample | Measurement) -> None:
        """Store a message for ``RECENT_NS``, for a reinitialisation, and give it to one that is under way.

        Parameters
        ----------
        message : before it is applied to the filter.
        """
        self._recent.append(message)
        if isinstance(message, ImuSample):
            while self._recent[0].t_ns < message.t_ns - RECENT_NS:
                self._recent.popleft()
        if self._replacement is not None:
            self._replacement.take(message)

    def check(self) -> None:
        """Replace the filter if it is not finite, its replacement is aligned, or its shadow filter is to take over."""
        active = self._active()
        if self._replacement is None and not is_finite(active.belief) and self.reinitialisation.has_good_position:
            self._replacement = self.reinitialisation.begin(active.belief.t_ns, self._recent)
        if self._replacement is not None and not self._replacement.waiting_for:
            self._reinitialise(active, self._replacement)
        if self._shadow is not None:
            self._compare(self._active(), self._shadow)

    def report(self, account: Mapping[str, int]) -> LocalisationReport:
        """Judge the filter over the last second; begin a reinitialisation or a shadow filter if that is necessary.

        Parameters
        ----------
        account : counts by "<sensor>.<outcome>" since the node's start, those of the active filter included.

        Returns
        -------
        The report of the filter's instant.
        """
        filter_ = self._active()
        t_ns = filter_.belief.t_ns
        self.report_ns = (t_ns // REPORT_NS + 1) * REPORT_NS
        sensors = self._monitor.sensors(t_ns, account)
        status, why = filter_status(sensors)
        if filter_.process_noise.is_inconsistent(t_ns) and status is FilterStatus.NOMINAL:
            status, why = FilterStatus.INCONSISTENT, "adcp: the water's relative velocity changes faster than water can"
        # The noise is read first: the reaction of this second must not change it in this second's report.
        walk = filter_.process_noise.walk_mps_per_rts(t_ns)
        self._react(filter_, status)
        return self._published(filter_, status, why, walk, sensors)

    def _react(self, filter_: ErrorStateFilter, status: FilterStatus) -> None:
        """Begin a reinitialisation or a shadow filter, or store a good belief."""
        t_ns = filter_.belief.t_ns
        if self._replacement is None and self.reinitialisation.watch(
            filter_.belief, status, broken=self._monitor.broken
        ):
            self._replacement = self.reinitialisation.begin(t_ns, self._recent)
        elif self.reinitialisation.inconsistent_since_ns == t_ns and self._shadow is None:
            spacing_ns = snapshot_spacing_ns(self._sensor_config)
            self._set_shadow(ShadowFilter(filter_, spacing_ns, self.reinitialisation.fork()))
        elif self.reinitialisation.is_belief_due(t_ns) and is_usable(filter_.belief):
            self.reinitialisation.store(filter_.propagated_belief())

    def _published(
        self, filter_: ErrorStateFilter, status: FilterStatus, why: str, walk: float, sensors: tuple[SensorReport, ...]
    ) -> LocalisationReport:
        """Return the report. A restart takes precedence over the status from the sensors."""
        t_ns = filter_.belief.t_ns
        if self._restarted is not None and t_ns - self._restarted[0] < RESTARTED_NS:
            status, why = FilterStatus.RESTARTED, why or self._restarted[1]
        elif self.reinitialisation.recent(t_ns):
            status, why = FilterStatus.RESTARTED, why or "reinitialised at its last good position"
        elif status is FilterStatus.NOMINAL and walk > 0.0:
            status, why = (
                FilterStatus.UNEXPECTED_CURRENT,
                f"changing water: process noise inflated to {1e3 * walk:.2g} mm/s per sqrt(s)",
            )
            if filter_.process_noise.level(t_ns) is NoiseLevel.FAST_AND_IMU:
                why = "the water changes for longer than a front, or a gyro has failed: process noise of both inflated"
        return LocalisationReport(
            t_ns=t_ns,
            status=status,
            why=why,
            restarts=self.reinitialisation.count,
            water_walk_mps_per_rts=walk,
            sensors=sensors,
            innovations=self._samples.take(),
        )

    def _active(self) -> ErrorStateFilter:
        filter_ = self._sequencing.filter
        assert filter_ is not None, "begin() must be called first"
        return filter_

    def _set_filter(self, filter_: ErrorStateFilter) -> None:
        """Make ``filter_`` the active one, observed by the monitor and the samples for the report alone."""
        filter_.observers[:] = [self._monitor.observe, self._samples.observe]
        self._sequencing.set_filter(filter_)

    def _set_shadow(self, shadow: ShadowFilter | None) -> None:
        self._shadow = self._sequencing.shadow = shadow

    def _reinitialise(self, old: ErrorStateFilter, alignment: Alignment) -> None:
        """Replace the filter at the time that it has reached, without publishing on the way."""
        self._replacement = None
        shadow = self._shadow
        self._set_shadow(None)  # it has received these messages already
        self._account.update(old.account)
        self._monitor.reset()
        belief, since = alignment.belief()
        # The prior of unknown water is wide: its first motion must not be detected as a front.
        adapts_from_ns = None if self.reinitialisation.restore_water(belief) else belief.t_ns + RESTARTED_NS
        new = ErrorStateFilter(self._sensor_config, self._config, belief, adapts_from_ns=adapts_from_ns)
        self._set_filter(new)
        self._sequencing.reapply([message for message in since if message.t_ns <= old.belief.t_ns])
        new.account.clear()  # these messages were counted when the old filter used them
        self._set_shadow(shadow)

    def _compare(self, active: ErrorStateFilter, shadow: ShadowFilter) -> None:
        """Let the shadow filter take over if the sensors agree with it; drop it if it cannot take over any more."""
        t_ns = active.belief.t_ns
        is_unreliable = self.reinitialisation.is_inconsistent or self.reinitialisation.recent(t_ns)
        if shadow.expired or not is_finite(shadow.filter.belief) or (shadow.agrees and not is_unreliable):
            self._set_shadow(None)
        elif shadow.agrees and shadow.is_better_than(active):
            self._set_shadow(None)
            self._replacement = None
            self._account.update(active.account)
            self._monitor.reset()
            shadow.filter.account.clear()  # counted by the filter that it replaces
            shadow.filter.process_noise.reset_tests(shadow.filter.belief)
            self._set_filter(shadow.filter)
            shadow.past.count = self.reinitialisation.count
            self.reinitialisation = shadow.past
            self._restarted = t_ns, "the shadow filter has replaced the active filter"
