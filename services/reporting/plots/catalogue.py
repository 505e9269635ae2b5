"""Catalogue of all plots of a run. Live page, report and figures show these and no others."""

from __future__ import annotations

from services.reporting.plots import palette
from services.reporting.plots.collector import INNOVATIONS, NIS
from services.reporting.plots.delays import STAGES as ROWS_OF_STAGES
from services.reporting.plots.description import Axis, Group, Level, Plot, Series, Style
from services.reporting.plots.vehicle_from_above import CURRENT_MPS

TIME = Axis(label="time (s)")
NO_TIMES = "no times; none are measured in lock step"

TRACK = Plot(
    name="track",
    title="View from above",
    x=Axis(label="east (m)", min_span=1.0),
    y=Axis(label="north (m)", min_span=1.0),
    over_time=False,
    equal=True,
    from_start=True,
    group=Group.LINE,
    drifts=True,
    follow=("hull", "target", "horizon", "port_arrow", "starboard_arrow", "current_arrow"),
    note=(
        "The true track is shifted to start at the estimate at t = 0, so the error of the satellite fix is removed. "
        "An arrow of thrust as long as the hull is the full thrust. Kept free: no centre of the vehicle within "
        "hull and margin of a zone or obstacle. Round a zone the line has the stated margin; the controller keeps 3 "
        "standard deviations of the position if they are more. Round an obstacle the lines have 3 standard deviations "
        "of its position too, at both ends of the plan."
    ),
    series=(
        Series(label="reference", table="reference", x="east_m", y="north_m", colour=palette.REFERENCE),
        Series(
            label="2 sigma of the estimate",
            table="ellipse",
            x="east_m",
            y="north_m",
            colour=palette.ESTIMATE,
            style=Style.DOTTED,
        ),
        Series(label="true", table="truth", x="east_m", y="north_m", colour=palette.TRUTH, compared=True),
        Series(label="estimate", table="track", x="east_m", y="north_m", colour=palette.ESTIMATE),
        Series(label="plan", table="horizon", x="east_m", y="north_m", colour=palette.PLAN, style=Style.DASHED),
        Series(label="target", table="target", x="east_m", y="north_m", colour=palette.REFERENCE, style=Style.CROSS),
        # Overlays: a table of lines in metres and a series here; None in the table separates two lines.
        Series(label="zone", table="zones", x="east_m", y="north_m", colour=palette.LIMIT),
        Series(
            label="kept free (stated margin)",
            table="kept_free",
            x="east_m",
            y="north_m",
            colour=palette.LIMIT,
            style=Style.DOTTED,
        ),
        Series(label="bounds the plan", table="bounding", x="east_m", y="north_m", colour=palette.PLAN),
        Series(label="obstacle", table="obstacles", x="east_m", y="north_m", colour=palette.MARK),
        Series(
            label="obstacle, predicted",
            table="obstacle_paths",
            x="east_m",
            y="north_m",
            colour=palette.MARK,
            style=Style.DASHED,
        ),
        Series(
            label="kept free (obstacle)",
            table="obstacles_kept_free",
            x="east_m",
            y="north_m",
            colour=palette.MARK,
            style=Style.DOTTED,
        ),
        Series(label="hull", table="hull", x="east_m", y="north_m", colour=palette.ESTIMATE),
        Series(label="port thrust", table="port_arrow", x="east_m", y="north_m", colour=palette.PORT),
        Series(label="starboard thrust", table="starboard_arrow", x="east_m", y="north_m", colour=palette.STARBOARD),
        Series(
            label=f"current ({CURRENT_MPS:g} m/s: as long as the hull)",
            table="current_arrow",
            x="east_m",
            y="north_m",
            colour=palette.CURRENT,
        ),
    ),
)


def _over_time(axis: str, colour: str) -> Plot:
    """Return the plot of the position along ``axis``, north or east."""
    name = f"{axis}_m"
    return Plot(
        name=axis,
        title=f"{axis.capitalize()} over time",
        x=TIME,
        y=Axis(label=f"{axis} (m)", min_span=0.1),
        group=Group.LINE,
        drifts=True,
        note="The true position is shifted to start at the estimate at t = 0.",
        series=(
            Series(label="reference", table="reference", x="t_s", y=name, colour=palette.REFERENCE, style=Style.DOTTED),
            Series(label="true", table="truth", x="t_s", y=name, colour=palette.TRUTH, compared=True),
            Series(label="estimate", table="track", x="t_s", y=name, colour=colour, style=Style.DASHED, compared=True),
        ),
    )


NORTH = _over_time("north", palette.NORTH)
EAST = _over_time("east", palette.EAST)

DEPTH = Plot(
    name="depth",
    title="Depth",
    x=TIME,
    y=Axis(label="depth (m)", downwards=True, min_span=1.0),
    group=Group.LINE,
    diving=True,
    series=(
        Series(
            label="reference", table="reference", x="t_s", y="depth_m", colour=palette.REFERENCE, style=Style.DOTTED
        ),
        Series(label="true", table="truth", x="t_s", y="depth_m", colour=palette.TRUTH, compared=True),
        Series(label="estimate", table="track", x="t_s", y="depth_m", colour=palette.ESTIMATE, style=Style.DASHED),
    ),
)

ERRORS = Plot(
    name="errors",
    title="Position error of the estimate",
    x=TIME,
    y=Axis(label="error (m)", min_span=0.1),
    note="Error gained since t = 0. Without a known truth: two standard deviations of the position.",
    group=Group.LINE,
    drifts=True,
    series=(
        Series(
            label="2 sigma of the estimate",
            table="errors",
            x="t_s",
            y="minus_2_sigma_m",
            y_high="plus_2_sigma_m",
            colour=palette.ESTIMATE,
            style=Style.BAND,
        ),
        Series(label="north", table="errors", x="t_s", y="north_m", colour=palette.NORTH, compared=True),
        Series(label="east", table="errors", x="t_s", y="east_m", colour=palette.EAST, compared=True),
    ),
)

TRACKING = Plot(
    name="tracking",
    title="Distance from the reference",
    x=TIME,
    y=Axis(label="distance (m)", min_span=0.1),
    group=Group.LINE,
    drifts=True,
    series=(
        Series(label="vehicle", table="true_distance", x="t_s", y="distance_m", colour=palette.TRUTH, compared=True),
        Series(label="estimate", table="distance", x="t_s", y="distance_m", colour=palette.ESTIMATE, compared=True),
    ),
)

THRUST = Plot(
    name="thrust",
    title="Port and starboard thrust",
    x=TIME,
    y=Axis(label="thrust (N)", min_span=10.0),
    series=(
        Series(label="port", table="thrust", x="t_s", y="port_N", colour=palette.PORT, compared=True),
        Series(label="starboard", table="thrust", x="t_s", y="starboard_N", colour=palette.STARBOARD, compared=True),
        Series(label="port, planned", table="ahead", x="t_s", y="port_N", colour=palette.PORT, style=Style.DASHED),
        Series(
            label="starboard, planned",
            table="ahead",
            x="t_s",
            y="starboard_N",
            colour=palette.STARBOARD,
            style=Style.DASHED,
        ),
    ),
    levels=(
        Level(label="limits", value="port_min_N", colour=palette.LIMIT),
        Level(label="limits", value="port_max_N", colour=palette.LIMIT),
        Level(label="limits", value="starboard_min_N", colour=palette.LIMIT),
        Level(label="limits", value="starboard_max_N", colour=palette.LIMIT),
    ),
)

CURRENT = Plot(
    name="current",
    title="Water current over depth",
    x=Axis(label="velocity (m/s)", min_span=0.1),
    y=Axis(label="depth (m)", downwards=True, min_span=1.0),
    over_time=False,
    note="Bands are two standard deviations. The true current is shown where the vehicle has been.",
    series=(
        Series(
            label="",
            table="profile",
            x="north_low_mps",
            x_high="north_high_mps",
            y="depth_m",
            colour=palette.NORTH,
            style=Style.BAND,
        ),
        Series(
            label="",
            table="profile",
            x="east_low_mps",
            x_high="east_high_mps",
            y="depth_m",
            colour=palette.EAST,
            style=Style.BAND,
        ),
        Series(label="north", table="profile", x="north_mps", y="depth_m", colour=palette.NORTH, compared=True),
        Series(label="east", table="profile", x="east_mps", y="depth_m", colour=palette.EAST, compared=True),
        Series(
            label="true north",
            table="true_current",
            x="north_mps",
            y="depth_m",
            colour=palette.NORTH,
            style=Style.DOTTED,
        ),
        Series(
            label="true east", table="true_current", x="east_mps", y="depth_m", colour=palette.EAST, style=Style.DOTTED
        ),
    ),
)

VERTICAL = Plot(
    name="vertical",
    title="Vertical thrust",
    x=TIME,
    y=Axis(label="thrust (N), down", min_span=10.0),
    empty="no vertical thruster",
    diving=True,
    series=(
        Series(label="delivered", table="thrust", x="t_s", y="vertical_N", colour=palette.OTHER, compared=True),
        Series(label="planned", table="ahead", x="t_s", y="vertical_N", colour=palette.PLAN, style=Style.DASHED),
    ),
    levels=(
        Level(label="limits", value="vertical_min_N", colour=palette.LIMIT),
        Level(label="limits", value="vertical_max_N", colour=palette.LIMIT),
    ),
)

HEADING = Plot(
    name="heading",
    title="Heading",
    x=TIME,
    y=Axis(label="heading, unwrapped (deg)", min_span=5.0),
    group=Group.LINE,
    note="The heading counts on beyond 180°. The reference of an underactuated vehicle has no heading: the controller "
    "plans one.",
    series=(
        Series(label="true", table="truth", x="t_s", y="heading_deg", colour=palette.TRUTH, compared=True),
        Series(label="estimate", table="track", x="t_s", y="heading_deg", colour=palette.ESTIMATE, style=Style.DASHED),
        Series(label="planned", table="ahead", x="t_s", y="heading_deg", colour=palette.PLAN, style=Style.DASHED),
    ),
)

YAW_RATE = Plot(
    name="yaw_rate",
    title="Yaw rate",
    x=TIME,
    y=Axis(label="yaw rate (deg/s)", min_span=1.0),
    note="Positive to starboard. There is no reference: the thrusters that turn the vehicle also drive it, so the "
    "controller plans the yaw rate. The estimate is the reading of the gyro without its bias, so it has the noise of "
    "the gyro. Points are 0.2 s apart or more, so oscillations above 2 Hz do not show.",
    series=(
        Series(label="true", table="truth", x="t_s", y="yaw_rate_dps", colour=palette.TRUTH, compared=True),
        Series(label="estimate", table="track", x="t_s", y="yaw_rate_dps", colour=palette.ESTIMATE, style=Style.DASHED),
        Series(label="planned", table="ahead", x="t_s", y="yaw_rate_dps", colour=palette.PLAN, style=Style.DASHED),
    ),
)

NIS_BY_SENSOR = Plot(
    name="nis",
    title="Innovations by sensor (NIS)",
    x=TIME,
    y=Axis(label="deviation of NIS from 1 (sd)", min_span=6.0),
    empty="no report of an estimator",
    note=(
        "Mean normalised innovation squared (NIS) per degree of freedom: 1 if the filter knows its own uncertainty. It "
        "is shown in standard deviations (sd) of a mean of so many innovations, so that one band holds 95 % of the "
        "consistent means of every sensor. Above it the filter is too sure of itself, or the sensor is wrong. tdcp: "
        "displacement between two satellite epochs, by carrier phase."
    ),
    series=tuple(
        Series(label=sensor, table=table, x="t_s", y="deviation", colour=palette.RUNS[i % len(palette.RUNS)])
        for i, (sensor, table) in enumerate(NIS.items())
    ),
    levels=(
        Level(label="95 % of consistent means", value="nis_low", colour=palette.LIMIT),
        Level(label="95 % of consistent means", value="nis_high", colour=palette.LIMIT),
    ),
)

ENERGY = Plot(
    name="energy",
    title="Propulsive energy",
    x=TIME,
    y=Axis(label="energy (J)", min_span=10.0),
    empty="the vehicle file has no torque coefficients",
    note="Mechanical energy at the shafts since t = 0, or since the time that the legend names.",
    drifts=True,
    series=(
        Series(label="all thrusters", table="energy", x="t_s", y="all_J", colour=palette.OTHER, compared=True),
        Series(
            label="lateral thrusters",
            table="energy",
            x="t_s",
            y="lateral_J",
            colour=palette.OTHER,
            style=Style.DASHED,
            compared=True,
        ),
    ),
)

LATENCY = Plot(
    name="latency",
    title="Cycle time and its deadline",
    x=TIME,
    y=Axis(label="wall time (ms)", log=True),
    empty=NO_TIMES,
    note="Each point is the slowest of several cycles.",
    series=(
        Series(label="deadline", table="latency", x="t_s", y="deadline_ms", colour=palette.LIMIT, style=Style.DOTTED),
        Series(label="cycle", table="latency", x="t_s", y="cycle_ms", colour=palette.OTHER, compared=True),
    ),
)

STAGES = Plot(
    name="stages",
    title="Delays by step (last two in vehicle time)",
    x=Axis(label="delay (ms)", log=True),
    y=Axis(label="step", downwards=True, rows=ROWS_OF_STAGES),
    over_time=False,
    empty=NO_TIMES,
    note="Percentiles of all cycles so far, or since the time that the legend names. The steps of a cycle are in wall "
    "time.",
    drifts=True,
    series=(
        Series(label="median", table="stages", x="median_ms", y="row", colour=palette.OTHER, style=Style.DOT),
        Series(label="99 %", table="stages", x="p99_ms", y="row", colour=palette.RARE, style=Style.RING),
        Series(label="longest", table="stages", x="max_ms", y="row", colour=palette.LIMIT, style=Style.CROSS),
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
    x=Axis(label="distance (m)", min_span=0.1),
    y=Axis(label="depth (m)", downwards=True, min_span=1.0),
    over_time=False,
    group=Group.REVIEW,
    diving=True,
    series=(
        Series(
            label="vehicle",
            table="vehicle_over_depth",
            x="distance_m",
            y="depth_m",
            colour=palette.TRUTH,
            compared=True,
        ),
        Series(
            label="estimate",
            table="estimate_over_depth",
            x="distance_m",
            y="depth_m",
            colour=palette.ESTIMATE,
            compared=True,
        ),
    ),
)


def _of_both_sides(table: str, x: str, unit: str) -> tuple[Series, Series]:
    """Return the series of port and starboard over ``x``, in columns that end with ``unit``."""
    return (
        Series(label="port", table=table, x=x, y=f"port_{unit}", colour=palette.PORT, compared=True),
        Series(label="starboard", table=table, x=x, y=f"starboard_{unit}", colour=palette.STARBOARD, compared=True),
    )


def _current_error(axis: str, colour: str) -> Plot:
    """Return the plot of the error of the estimated current along ``axis``, north or east."""
    columns = (("error", f"{axis}_mps"), ("+2 sd", f"{axis}_high_mps"), ("-2 sd", f"{axis}_low_mps"))
    return Plot(
        name=f"current_error_{axis}",
        title=f"Error of the estimated current, {axis}",
        x=Axis(label=f"error {axis} (m/s)", min_span=0.02),
        y=Axis(label="depth (m)", downwards=True, min_span=1.0),
        over_time=False,
        group=Group.REVIEW,
        diving=True,
        note="At the end of the run, where the vehicle has been; two standard deviations of the filter.",
        series=tuple(
            Series(
                label=label,
                table="current_error",
                x=column,
                y="depth_m",
                colour=colour if label == "error" else palette.REFERENCE,
                style=Style.LINE if label == "error" else Style.DASHED,
                compared=True,
            )
            for label, column in columns
        ),
    )


HISTOGRAM = Plot(
    name="histogram",
    title="Histogram of the lateral thrusts",
    x=Axis(label="thrust (N)", min_span=10.0),
    y=Axis(label="share of the time (%)"),
    over_time=False,
    group=Group.REVIEW,
    series=_of_both_sides("histogram", "thrust_N", "percent"),
)

SPECTRUM = Plot(
    name="spectrum",
    title="Spectrum of the lateral thrusts",
    x=Axis(label="frequency (Hz)", log=True),
    y=Axis(label="power density (N²/Hz)", log=True),
    over_time=False,
    group=Group.REVIEW,
    note="Mean of overlapping segments with a Hann window (Welch), from the thrusts as they are plotted over time.",
    series=_of_both_sides("spectrum", "frequency_Hz", "N2pHz"),
)

RESIDUALS = Plot(
    name="residuals",
    title="Position error in standard deviations",
    x=TIME,
    y=Axis(label="error / standard deviation (1)", min_span=4.0),
    group=Group.REVIEW,
    note="Error since t = 0, divided by the standard deviation of the filter in its worst direction; the band is ±2.",
    series=(
        Series(
            label="±2", table="residuals", x="t_s", y="low", y_high="high", colour=palette.REFERENCE, style=Style.BAND
        ),
        Series(label="north", table="residuals", x="t_s", y="north", colour=palette.NORTH, compared=True),
        Series(label="east", table="residuals", x="t_s", y="east", colour=palette.EAST, compared=True),
    ),
)

UNITS = {"adcp": "m/s", "bottom_track": "m/s", "gnss_velocity": "m/s", "compass": "deg"}
"""Units of innovations that are not in metres."""


def _innovations(measured: str, table: str) -> Plot:
    """Return the plot of the innovations of a sensor in their own unit."""
    return Plot(
        name=table,
        title=f"Innovations: {measured.replace('_', ' ')}",
        x=TIME,
        y=Axis(label=f"innovation ({UNITS.get(measured, 'm')})"),
        group=Group.REVIEW,
        note=(
            "Measurement minus its prediction by the filter, of measurements that passed the gate: at most four of the "
            "newest message each second, of a profiler about one a beam. The band is two standard deviations that "
            "the filter expects, and holds 95 % of the points if it is consistent. Points that are mostly on one side "
            "of zero show a bias."
        ),
        series=(
            Series(
                label="2 sd",
                table=table,
                x="t_s",
                y="minus_2_sd",
                y_high="plus_2_sd",
                colour=palette.REFERENCE,
                style=Style.BAND,
            ),
            Series(
                label="innovation", table=table, x="t_s", y="innovation", colour=palette.ESTIMATE, style=Style.POINT
            ),
        ),
    )


REVIEW = (
    *(OVER_DEPTH, _current_error("north", palette.NORTH), _current_error("east", palette.EAST)),
    *(HISTOGRAM, SPECTRUM, RESIDUALS),
    *(_innovations(measured, table) for measured, table in INNOVATIONS.items()),
)
"""Plots of a recorded run, which the report shows below the others, most of them from tables of ``analysis.py``."""
