"""Collector of plot tables from the messages of a recording or of a running bus.

Memory is bounded for runs of any length. The tables of ``HISTORY`` grow and are decimated; those of
``Collector.current_tables`` hold the newest state only: horizon of the newest plan, error ellipse, current profile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from ltv_mpc.messages import (
    Acknowledgement,
    Applied,
    Clock,
    Command,
    ControllerStatus,
    CurrentProfile,
    CycleTiming,
    Estimate,
    FenceInForce,
    InnovationSample,
    LocalisationReport,
    Message,
    NodeSettings,
    Plan,
    RunEvent,
    Truth,
)
from ltv_mpc.vehicle.parameters import Vehicle
from services.recording.node_settings import is_in_places, vehicle_of
from services.reporting.plots import newest
from services.reporting.plots.delays import Delays
from services.reporting.plots.distances import Distances
from services.reporting.plots.energy import Energy
from services.reporting.plots.events import Marks
from services.reporting.plots.newest import SIGMAS
from services.reporting.plots.table import Columns, Table
from services.reporting.plots.truth import TrueTrack, principal

S = TypeVar("S", bound=Message)

NEWEST = (Clock, Truth, Estimate, Applied, FenceInForce, ControllerStatus, LocalisationReport)
"""Messages of which the live page shows the newest."""

EVERY = (Plan, CycleTiming, RunEvent, Command, Acknowledgement)
"""Messages of which page and report show each one."""

MAX_PLAIN_NS = 1_000_000_000_000_000
"""Largest vehicle time that is plotted as it is: 11 days. Times since 1970 are plotted from the first message on."""

ROWS = 1_500
"""Row limit of a table; about the width of a screen in pixels."""

MOTION = ("t_s", "north_m", "east_m", "depth_m", "heading_deg", "yaw_rate_dps")
CORRECTING = (
    "gnss",
    "tdcp",
    "adcp",
    "pressure",
    "compass",
    "bottom_track",
    "lbl",
    "usbl",
)
"""Sensors that correct the filter, as in the registry of the sensors: importing that takes half a second and 58 MB."""
NIS = {sensor: f"nis_{sensor}" for sensor in CORRECTING}
"""Tables of the normalised innovations, by sensor."""

MEASURED = (*("gnss_position", "gnss_velocity"), *(sensor for sensor in CORRECTING if sensor != "gnss"))
"""Measurements by sensor; those of the satellite receiver have two units."""
INNOVATIONS = {measured: f"innovation_{measured}" for measured in MEASURED}
"""Tables of the innovations in the unit of the measurement, degrees for an angle."""

HISTORY = {
    "track": MOTION,
    "truth": MOTION,
    "reference": ("t_s", "north_m", "east_m", "depth_m"),
    "errors": ("t_s", "north_m", "east_m", "minus_2_sigma_m", "plus_2_sigma_m", "north_sd", "east_sd"),
    "distance": ("t_s", "distance_m", "depth_m"),
    "true_distance": ("t_s", "distance_m", "depth_m"),
    "thrust": ("t_s", "port_N", "starboard_N", "vertical_N"),
    "energy": ("t_s", "all_J", "lateral_J"),
    **dict.fromkeys(NIS.values(), ("t_s", "deviation")),
    **dict.fromkeys(INNOVATIONS.values(), ("t_s", "innovation", "minus_2_sd", "plus_2_sd")),
    "true_current": ("depth_m", "north_mps", "east_mps"),
    "latency": ("t_s", "cycle_ms", "deadline_ms"),
}
PEAKS = {"latency": "cycle_ms"}

NIS_BAND = 1.96
"""Half width of the band that holds 95 % of all consistent means (standard deviations)."""

MIN_SD_M = 1e-3
"""Standard deviation of the position up to which an error is not divided by it."""

VELOCITY_ROW = 2
"""First row of a satellite fix that is a velocity."""

LATE_S = 1.0
"""Vehicle time of the first estimate (s) after which the data do not begin with the run."""

ESTIMATES_NS = 100_000_000


class Collector:
    """Builder of plot tables; takes messages in the order of their publication.

    ``vehicle`` gives limits, hull and energy; None: that of the first settings which a process publishes. ``origin_ns``
    is the vehicle time at which plotted times are zero; None: the time of the first message, if it is large as a time
    since 1970 is, otherwise 0.
    """

    def __init__(self, vehicle: Vehicle | None = None, *, rows: int = ROWS, origin_ns: int | None = None) -> None:
        self._origin_ns = origin_ns
        self.tables = {name: Table(columns, limit=rows, peak=PEAKS.get(name, "")) for name, columns in HISTORY.items()}
        self.marks = Marks(self.seconds)
        self.values: dict[str, float] = {}
        self.vehicle: Vehicle | None = None
        self.set_vehicle(vehicle)
        self._newest: dict[type, Any] = {}  # message by type, and the profile of the current
        self._true = TrueTrack()
        self._distances = Distances(self.tables, self.seconds)
        self._delays = Delays(self.tables["latency"], self.seconds)
        self._energy = Energy()
        self._heading_deg = 0.0  # of the newest estimate, without jumps
        self._handlers: dict[type[Message], Callable[[Any], None]] = {
            Truth: self._add_truth,
            Estimate: self._add_estimate,
            Plan: self._distances.add_plan,
            Applied: self._add_applied,
            CycleTiming: lambda timing: self._delays.add_timing(timing, self.newest(Plan), self.newest(Clock)),
            LocalisationReport: self._add_report,
            NodeSettings: lambda settings: self.set_files(settings.files),
        }

    @property
    def error_m(self) -> float | None:
        """Newest distance of the estimate from the reference; None without one of them."""
        return self._distances.newest_m.get("distance")

    @property
    def true_error_m(self) -> float | None:
        """Newest distance of the vehicle from the reference; None without a known truth."""
        return self._distances.newest_m.get("true_distance")

    @property
    def since(self) -> str:
        """Time from which the vehicle's distance counts, as text; empty where it is absolute."""
        return "" if self._true.in_places else f"since t = {self.values.get('since_s', 0.0):g} s"

    def set_files(self, files: Mapping[str, str]) -> None:
        """Take vehicle and kind of reference from the settings files of a run or of a process."""
        if self.vehicle is None:
            self.set_vehicle(vehicle_of(files))
        if is_in_places(files):
            self._true.in_places = True
            self.values["in_places"] = 1.0

    def set_vehicle(self, vehicle: Vehicle | None) -> None:
        """Set the vehicle if none is known yet."""
        if self.vehicle is not None or vehicle is None:
            return
        self.vehicle = vehicle
        for side, thruster in zip(("port", "starboard", "vertical"), vehicle.thrusters, strict=True):
            if thruster.max_N > 0.0:
                self.values |= {f"{side}_min_N": thruster.min_N, f"{side}_max_N": thruster.max_N}

    def seconds(self, t_ns: int) -> float:
        """Return a vehicle time as it is plotted (s)."""
        if self._origin_ns is None:
            self._origin_ns = t_ns if abs(t_ns) > MAX_PLAIN_NS else 0
        return (t_ns - self._origin_ns) / 1e9

    def add(self, message: Message, epoch: int) -> None:
        """Add a message; ``epoch`` is the one of its sender. The same one, or another estimate so soon, is ignored."""
        last = self.newest(Estimate)
        soon = isinstance(message, Estimate) and last is not None and 0 <= message.t_ns - last.t_ns < ESTIMATES_NS
        if soon or message is self.newest(type(message)):
            return
        self._newest[type(message)] = message
        handler = self._handlers.get(type(message))
        if handler is not None:
            handler(message)
        self.marks.add(message, epoch)

    def newest(self, kind: type[S]) -> S | None:
        """Return the newest message of a type."""
        found: S | None = self._newest.get(kind)
        return found

    def current_tables(self) -> dict[str, Columns]:
        """Return the tables of the newest state."""
        estimate = self.newest(Estimate)
        covariance = None
        if estimate is not None:
            covariance = self._true.covariance(estimate, absolute=self._true.in_places)
        tables = newest.tables(self._newest, self.vehicle, covariance, self.seconds, self._unwrapped_deg)
        return {**tables, "stages": self._delays.stages()}

    def all_tables(self) -> dict[str, Columns]:
        """Return every table with all rows."""
        return {**{name: table.since(0) for name, table in self.tables.items()}, **self.current_tables()}

    # --- one message type each ---------------------------------------------------------------------------------------

    def _add_truth(self, truth: Truth) -> None:
        if self._true.add(truth):
            self._show_truth(truth)

    def _show_truth(self, truth: Truth) -> None:
        shown = self._true.position(truth)
        if shown is None:
            return
        position = *shown, truth.position_m[2]
        turning = self._unwrapped_deg(truth.attitude_rad[2]), math.degrees(truth.yaw_rate_radps)
        self.tables["truth"].add(self.seconds(truth.t_ns), *position, *turning)
        self.tables["true_current"].add(truth.position_m[2], *truth.current_mps)
        self._distances.add_position("true_distance", truth.t_ns, position)

    def _add_estimate(self, estimate: Estimate) -> None:
        if estimate.current is not None:
            self._newest[CurrentProfile] = estimate.current
        for truth in self._true.begin(estimate):
            self._show_truth(truth)
        if self._true.start_error is not None and self._true.start_ns > LATE_S * 1e9:
            self.values["since_s"] = round(self.seconds(self._true.start_ns), 1)
        position = estimate.north_m, estimate.east_m, estimate.depth_m
        self._heading_deg = self._unwrapped_deg(estimate.heading_rad)
        turning = self._heading_deg, math.degrees(estimate.yaw_rate_radps)
        self.tables["track"].add(self.seconds(estimate.t_ns), *position, *turning)
        self._distances.add_position("distance", estimate.t_ns, position)
        error = self._true.error(estimate)
        if error is None and self._true.known:
            return
        covariance = self._true.covariance(estimate)
        sd_m = math.nan if covariance is None else float(principal(covariance)[0][-1])
        north_m, east_m = error or (math.nan, math.nan)
        in_sd = (north_m / sd_m, east_m / sd_m) if sd_m > MIN_SD_M else (None, None)
        self.tables["errors"].add(self.seconds(estimate.t_ns), north_m, east_m, -SIGMAS * sd_m, SIGMAS * sd_m, *in_sd)
        self.values |= {"sd_low": -SIGMAS, "sd_high": SIGMAS}

    def _add_applied(self, applied: Applied) -> None:
        self._delays.add_applied(applied)
        self.tables["thrust"].add(self.seconds(applied.t_ns), *applied.thrust_N)
        if self.vehicle is not None:
            self._energy.add(applied, self.vehicle, self.newest(Truth), self.newest(Estimate))
            if self._energy.joules is not None:
                self.tables["energy"].add(self.seconds(applied.t_ns), *self._energy.joules)

    def _add_report(self, report: LocalisationReport) -> None:
        for sensor in report.sensors:
            count = sensor.used + sensor.rejected.get("gate", 0)
            if sensor.nis is not None and count and sensor.sensor in NIS:
                self.tables[NIS[sensor.sensor]].add(self.seconds(report.t_ns), nis_deviation(sensor.nis, count))
                self.values |= {"nis_low": -NIS_BAND, "nis_high": NIS_BAND}
        for sample in report.innovations:
            if sample.sensor in NIS:
                self._add_innovations(sample)

    def _add_innovations(self, sample: InnovationSample) -> None:
        """Add a row for each innovation; the band is that of their mean square."""
        kinds: dict[str, list[tuple[float, float]]] = {}
        for row, innovation, sd in zip(sample.rows, sample.innovations, sample.sd, strict=True):
            kind = "position" if row < VELOCITY_ROW else "velocity"
            measured = f"gnss_{kind}" if sample.sensor == "gnss" else sample.sensor
            kinds.setdefault(measured, []).append((innovation, sd))
        for measured, pairs in kinds.items():
            scale = math.degrees(1.0) if measured == "compass" else 1.0
            band = 2.0 * scale * math.sqrt(sum(sd * sd for _, sd in pairs) / len(pairs))
            for innovation, _ in pairs:
                self.tables[INNOVATIONS[measured]].add(self.seconds(sample.t_ns), scale * innovation, -band, band)

    def _unwrapped_deg(self, heading_rad: float) -> float:
        """Return the heading (deg) that is nearest to that of the newest estimate, so that a turn has no jump."""
        heading_deg = math.degrees(heading_rad)
        return heading_deg + 360.0 * round((self._heading_deg - heading_deg) / 360.0)


def nis_deviation(nis: float, count: int) -> float:
    """Return how far a mean of ``count`` innovations squared is from the mean of consistent ones (standard deviations).

    Wilson and Hilferty (1931): the cube root of chi-squared / n is nearly normal, mean 1 - 2 / 9n, variance 2 / 9n.
    """
    variance = 2.0 / (9.0 * count)
    return (math.cbrt(nis) - 1.0 + variance) / math.sqrt(variance)
