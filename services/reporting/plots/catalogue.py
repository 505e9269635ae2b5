"""Catalogue of all plots of a run. Live page, report and figures show these and no others."""

from __future__ import annotations

from typing import Any

from services.reporting.plots import palette
from services.reporting.plots.collector import HISTORY, INNOVATIONS, NIS
from services.reporting.plots.delays import STAGES as ROWS_OF_STAGES
from services.reporting.plots.description import Axis, Group, Level, Plot, Series, Style
from services.reporting.plots.vehicle_from_above import CURRENT_MPS

SHIFTED = (
    "Where the reference begins at the vehicle, the true position is shifted to start at the estimate at t = 0, and "
    "its error is drift since then; where the reference is given in places, nothing is shifted."
)
NO_TIMES = "no times; none are measured in lock step"


def _limits(label: str, *values: str) -> tuple[Level, ...]:
    """Return a horizontal line at each of these values of the run."""
    return tuple(Level(label, value, palette.LIMIT) for value in values)


def _band(label: str, table: str, low: str, high: str, colour: str) -> Series:
    """Return a band over time between two columns."""
    return Series(label, table, "t_s", low, colour, Style.BAND, y_high=high)


TRACK = Plot(
    name="track",
    title="View from above",
    x=Axis("east (m)", min_span=1.0),
    y=Axis("north (m)", min_span=1.0),
    equal=True,
    from_start=True,
    group=Group.LINE,
    drifts=True,
    follow=("hull", "target", "horizon", "port_arrow", "starboard_arrow", "current_arrow"),
    note=(
        "Where the reference begins at the vehicle, the true track is shifted to start at the estimate at t = 0, so "
        "the error of the satellite fix is removed. "
        "An arrow of thrust as long as the hull is the full thrust. Kept free: no centre of the vehicle within "
        "hull and margin of a zone or obstacle. Round a zone the line has the stated margin; the controller keeps 3 "
        "standard deviations of the position if they are more. Round an obstacle the lines have 3 standard deviations "
        "of its position too, at both ends of the plan."
    ),
    series=(
        Series("reference", "reference", "east_m", "north_m", palette.REFERENCE),
        Series("2 sigma of the estimate", "ellipse", "east_m", "north_m", palette.ESTIMATE, Style.DOTTED),
        Series("true", "truth", "east_m", "north_m", palette.TRUTH, compared=True),
        Series("estimate", "track", "east_m", "north_m", palette.ESTIMATE),
        Series("plan", "horizon", "east_m", "north_m", palette.PLAN, Style.DASHED),
        Series("target", "target", "east_m", "north_m", palette.REFERENCE, Style.CROSS),
        # Overlays: a table of lines in metres and a series here; None in the table separates two lines.
        Series("zone", "zones", "east_m", "north_m", palette.LIMIT),
        Series("kept free (stated margin)", "kept_free", "east_m", "north_m", palette.LIMIT, Style.DOTTED),
        Series("bounds the plan", "bounding", "east_m", "north_m", palette.PLAN),
        Series("obstacle", "obstacles", "east_m", "north_m", palette.MARK),
        Series("obstacle, predicted", "obstacle_paths", "east_m", "north_m", palette.MARK, Style.DASHED),
        Series("kept free (obstacle)", "obstacles_kept_free", "east_m", "north_m", palette.MARK, Style.DOTTED),
        Series("hull", "hull", "east_m", "north_m", palette.ESTIMATE),
        Series("port thrust", "port_arrow", "east_m", "north_m", palette.PORT),
        Series("starboard thrust", "starboard_arrow", "east_m", "north_m", palette.STARBOARD),
        Series(
            f"current ({CURRENT_MPS:g} m/s: as long as the hull)", "current_arrow", "east_m", "north_m", palette.CURRENT
        ),
    ),
)


def _motion(column: str, title: str, y: Axis, colour: str = palette.ESTIMATE, **more: Any) -> Plot:
    """Return the plot of one column of the motion over time: true, estimate, and the reference, or else the plan."""
    true = Series("true", "truth", "t_s", column, palette.TRUTH, compared=True)
    compared = colour != palette.ESTIMATE
    estimate = Series("estimate", "track", "t_s", column, colour, Style.DASHED, compared=compared)
    series = true, estimate, Series("planned", "ahead", "t_s", column, palette.PLAN, Style.DASHED)
    if column in HISTORY["reference"]:
        series = Series("reference", "reference", "t_s", column, palette.REFERENCE, Style.DOTTED), true, estimate
    return Plot(name=column.rpartition("_")[0], title=title, y=y, series=series, **more)


_SHIFTED = {"drifts": True, "note": SHIFTED}

NORTH = _motion(
    "north_m", "North over time", Axis("north (m)", min_span=0.1), palette.NORTH, group=Group.LINE, **_SHIFTED
)
EAST = _motion("east_m", "East over time", Axis("east (m)", min_span=0.1), palette.EAST, group=Group.LINE, **_SHIFTED)
DEPTH = _motion("depth_m", "Depth", Axis("depth (m)", downwards=True, min_span=1.0), group=Group.LINE, diving=True)

ERRORS = Plot(
    name="errors",
    title="Position error of the estimate",
    y=Axis("error (m)", min_span=0.1),
    note="Error gained since t = 0. Without a known truth: two standard deviations of the position.",
    group=Group.LINE,
    drifts=True,
    series=(
        _band("2 sigma of the estimate", "errors", "minus_2_sigma_m", "plus_2_sigma_m", palette.ESTIMATE),
        Series("north", "errors", "t_s", "north_m", palette.NORTH, compared=True),
        Series("east", "errors", "t_s", "east_m", palette.EAST, compared=True),
    ),
)

TRACKING = Plot(
    name="tracking",
    title="Distance from the reference",
    y=Axis("distance (m)", min_span=0.1),
    note=SHIFTED,
    group=Group.LINE,
    drifts=True,
    series=(
        Series("vehicle", "true_distance", "t_s", "distance_m", palette.TRUTH, compared=True),
        Series("estimate", "distance", "t_s", "distance_m", palette.ESTIMATE, compared=True),
    ),
)

THRUST = Plot(
    name="thrust",
    title="Port and starboard thrust",
    y=Axis("thrust (N)", min_span=10.0),
    series=(
        Series("port", "thrust", "t_s", "port_N", palette.PORT, compared=True),
        Series("starboard", "thrust", "t_s", "starboard_N", palette.STARBOARD, compared=True),
        Series("port, planned", "ahead", "t_s", "port_N", palette.PORT, Style.DASHED),
        Series("starboard, planned", "ahead", "t_s", "starboard_N", palette.STARBOARD, Style.DASHED),
    ),
    levels=_limits("limits", "port_min_N", "port_max_N", "starboard_min_N", "starboard_max_N"),
)

CURRENT = Plot(
    name="current",
    title="Water current over depth",
    x=Axis("velocity (m/s)", min_span=0.1),
    y=Axis("depth (m)", downwards=True, min_span=1.0),
    note="Bands are two standard deviations. The true current is shown where the vehicle has been.",
    series=(
        Series("", "profile", "north_low_mps", "depth_m", palette.NORTH, Style.BAND, x_high="north_high_mps"),
        Series("", "profile", "east_low_mps", "depth_m", palette.EAST, Style.BAND, x_high="east_high_mps"),
        Series("north", "profile", "north_mps", "depth_m", palette.NORTH, compared=True),
        Series("east", "profile", "east_mps", "depth_m", palette.EAST, compared=True),
        Series("true north", "true_current", "north_mps", "depth_m", palette.NORTH, Style.DOTTED),
        Series("true east", "true_current", "east_mps", "depth_m", palette.EAST, Style.DOTTED),
    ),
)

VERTICAL = Plot(
    name="vertical",
    title="Vertical thrust",
    y=Axis("thrust (N), down", min_span=10.0),
    empty="no vertical thruster",
    diving=True,
    series=(
        Series("delivered", "thrust", "t_s", "vertical_N", palette.OTHER, compared=True),
        Series("planned", "ahead", "t_s", "vertical_N", palette.PLAN, Style.DASHED),
    ),
    levels=_limits("limits", "vertical_min_N", "vertical_max_N"),
)

HEADING = _motion(
    "heading_deg",
    "Heading",
    Axis("heading, unwrapped (deg)", min_span=5.0),
    group=Group.LINE,
    note="The heading counts on beyond 180°. The reference of an underactuated vehicle has no heading: the controller "
    "plans one.",
)

YAW_RATE = _motion(
    "yaw_rate_dps",
    "Yaw rate",
    Axis("yaw rate (deg/s)", min_span=1.0),
    note="Positive to starboard. There is no reference: the thrusters that turn the vehicle also drive it, so the "
    "controller plans the yaw rate. The estimate is the reading of the gyro without its bias, so it has the noise of "
    "the gyro. Points are 0.2 s apart or more, so oscillations above 2 Hz do not show.",
)

NIS_BY_SENSOR = Plot(
    name="nis",
    title="Innovations by sensor (NIS)",
    y=Axis("deviation of NIS from 1 (sd)", min_span=6.0),
    empty="no report of an estimator",
    note=(
        "Mean normalised innovation squared (NIS) per degree of freedom: 1 if the filter knows its own uncertainty. It "
        "is shown in standard deviations (sd) of a mean of so many innovations, so that one band holds 95 % of the "
        "consistent means of every sensor. Above it the filter is too sure of itself, or the sensor is wrong. tdcp: "
        "displacement between two satellite epochs, by carrier phase."
    ),
    series=tuple(
        Series(sensor, table, "t_s", "deviation", palette.RUNS[i % len(palette.RUNS)])
        for i, (sensor, table) in enumerate(NIS.items())
    ),
    levels=_limits("95 % of consistent means", "nis_low", "nis_high"),
)

ENERGY = Plot(
    name="energy",
    title="Propulsive energy",
    y=Axis("energy (J)", min_span=10.0),
    empty="the vehicle file has no torque coefficients",
    note="Mechanical energy at the shafts since t = 0, or since the time that the legend names.",
    drifts=True,
    series=(
        Series("all thrusters", "energy", "t_s", "all_J", palette.OTHER, compared=True),
        Series("lateral thrusters", "energy", "t_s", "lateral_J", palette.OTHER, Style.DASHED, compared=True),
    ),
)

LATENCY = Plot(
    name="latency",
    title="Cycle time and its deadline",
    y=Axis("wall time (ms)", log=True),
    empty=NO_TIMES,
    note="Each point is the slowest of several cycles.",
    series=(
        Series("deadline", "latency", "t_s", "deadline_ms", palette.LIMIT, Style.DOTTED),
        Series("cycle", "latency", "t_s", "cycle_ms", palette.OTHER, compared=True),
    ),
)

STAGES = Plot(
    name="stages",
    title="Delays by step (last two in vehicle time)",
    x=Axis("delay (ms)", log=True),
    y=Axis("step", downwards=True, rows=ROWS_OF_STAGES),
    empty=NO_TIMES,
    note="Percentiles of all cycles so far, or since the time that the legend names. The steps of a cycle are in wall "
    "time.",
    drifts=True,
    series=(
        Series("median", "stages", "median_ms", "row", palette.OTHER, Style.DOT),
        Series("99 %", "stages", "p99_ms", "row", palette.RARE, Style.RING),
        Series("longest", "stages", "max_ms", "row", palette.LIMIT, Style.CROSS),
    ),
)

PLOTS = (
    *(TRACK, TRACKING, NORTH, EAST, DEPTH, ERRORS, HEADING),
    *(THRUST, CURRENT, YAW_RATE, VERTICAL, NIS_BY_SENSOR, ENERGY, LATENCY, STAGES),
)
"""Every plot of a run, in the order in which a reader asks: is it on its line, and why or why not."""

OVER_DEPTH = Plot(
    name="over_depth",
    title="Distance from the reference over depth",
    x=Axis("distance (m)", min_span=0.1),
    y=Axis("depth (m)", downwards=True, min_span=1.0),
    group=Group.REVIEW,
    diving=True,
    series=(
        Series("vehicle", "true_distance", "distance_m", "depth_m", palette.TRUTH, compared=True),
        Series("estimate", "distance", "distance_m", "depth_m", palette.ESTIMATE, compared=True),
    ),
)


def _of_both_sides(table: str, x: str, unit: str) -> tuple[Series, Series]:
    """Return the series of port and starboard over ``x``, in columns that end with ``unit``."""
    return (
        Series("port", table, x, f"port_{unit}", palette.PORT, compared=True),
        Series("starboard", table, x, f"starboard_{unit}", palette.STARBOARD, compared=True),
    )


def _current_error(axis: str, colour: str) -> Plot:
    """Return the plot of the error of the estimated current along ``axis``, north or east."""
    return Plot(
        name=f"current_error_{axis}",
        title=f"Error of the estimated current, {axis}",
        x=Axis(f"error {axis} (m/s)", min_span=0.02),
        y=Axis("depth (m)", downwards=True, min_span=1.0),
        group=Group.REVIEW,
        diving=True,
        note="At the end of the run, where the vehicle has been; two standard deviations of the filter.",
        series=(
            Series("error", "current_error", f"{axis}_mps", "depth_m", colour, compared=True),
            *(
                Series(label, "current_error", column, "depth_m", palette.REFERENCE, Style.DASHED, compared=True)
                for label, column in (("+2 sd", f"{axis}_high_mps"), ("-2 sd", f"{axis}_low_mps"))
            ),
        ),
    )


HISTOGRAM = Plot(
    name="histogram",
    title="Histogram of the lateral thrusts",
    x=Axis("thrust (N)", min_span=10.0),
    y=Axis("share of the time (%)"),
    group=Group.REVIEW,
    series=_of_both_sides("histogram", "thrust_N", "percent"),
)

SPECTRUM = Plot(
    name="spectrum",
    title="Spectrum of the lateral thrusts",
    x=Axis("frequency (Hz)", log=True),
    y=Axis("power density (N²/Hz)", log=True),
    group=Group.REVIEW,
    note="Mean of overlapping segments with a Hann window (Welch), from the thrusts as they are plotted over time.",
    series=_of_both_sides("spectrum", "frequency_Hz", "N2pHz"),
)

RESIDUALS = Plot(
    name="residuals",
    title="Position error in standard deviations",
    y=Axis("error / standard deviation (1)", min_span=4.0),
    group=Group.REVIEW,
    note="Error since t = 0, divided by the standard deviation of the filter in its worst direction.",
    series=(
        Series("north", "errors", "t_s", "north_sd", palette.NORTH, compared=True),
        Series("east", "errors", "t_s", "east_sd", palette.EAST, compared=True),
    ),
    levels=_limits("±2", "sd_low", "sd_high"),
)

UNITS = {"adcp": "m/s", "bottom_track": "m/s", "gnss_velocity": "m/s", "compass": "deg"}
"""Units of innovations that are not in metres."""


def _innovations(measured: str, table: str) -> Plot:
    """Return the plot of the innovations of a sensor in their own unit."""
    return Plot(
        name=table,
        title=f"Innovations: {measured.replace('_', ' ')}",
        y=Axis(f"innovation ({UNITS.get(measured, 'm')})"),
        group=Group.REVIEW,
        note=(
            "Measurement minus its prediction by the filter, of measurements that passed the gate: at most four of the "
            "newest message each second, of a profiler about one a beam. The band is two standard deviations that "
            "the filter expects, and holds 95 % of the points if it is consistent. Points that are mostly on one side "
            "of zero show a bias."
        ),
        series=(
            _band("2 sd", table, "minus_2_sd", "plus_2_sd", palette.REFERENCE),
            Series("innovation", table, "t_s", "innovation", palette.ESTIMATE, Style.POINT),
        ),
    )


REVIEW = (
    *(OVER_DEPTH, _current_error("north", palette.NORTH), _current_error("east", palette.EAST)),
    *(HISTOGRAM, SPECTRUM, RESIDUALS),
    *(_innovations(measured, table) for measured, table in INNOVATIONS.items()),
)
"""Plots of a recorded run, which the report shows below the others, most of them from tables of ``analysis.py``."""
