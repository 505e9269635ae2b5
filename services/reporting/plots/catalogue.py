"""Catalogue of all plots of a run. Live page, report and figures show these and no others."""

from __future__ import annotations

from services.reporting.plots import palette
from services.reporting.plots.description import Axis, Level, Plot, Series, Style

TIME = Axis(label="time (s)")

TRACK = Plot(
    name="track",
    title="Horizontal track",
    x=Axis(label="east (m)", min_span=1.0),
    y=Axis(label="north (m)", min_span=1.0),
    over_time=False,
    equal=True,
    from_start=True,
    note="The true track is shifted to start at the estimate at t = 0, so the error of the satellite fix is removed.",
    series=(
        Series(label="reference", table="reference", x="east_m", y="north_m", colour=palette.REFERENCE),
        Series(label="2 sigma", table="ellipse", x="east_m", y="north_m", colour=palette.ESTIMATE, style=Style.DOTTED),
        Series(label="true", table="truth", x="east_m", y="north_m", colour=palette.TRUTH, compared=True),
        Series(label="estimate", table="track", x="east_m", y="north_m", colour=palette.ESTIMATE),
        Series(label="predicted", table="horizon", x="east_m", y="north_m", colour=palette.PLAN, style=Style.DASHED),
        Series(label="target", table="target", x="east_m", y="north_m", colour=palette.REFERENCE, style=Style.CROSS),
    ),
)

DEPTH = Plot(
    name="depth",
    title="Depth",
    x=TIME,
    y=Axis(label="depth (m)", downwards=True, min_span=1.0),
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
    series=(
        Series(
            label="2 sigma",
            table="errors",
            x="t_s",
            y="minus_2_sigma_m",
            y_high="plus_2_sigma_m",
            colour=palette.REFERENCE,
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
    series=(
        Series(label="true", table="true_distance", x="t_s", y="distance_m", colour=palette.TRUTH, compared=True),
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

LATENCY = Plot(
    name="latency",
    title="Delays, and the cycle by stage",
    x=TIME,
    y=Axis(label="time (ms)", log=True),
    empty="no times; none are measured in lock step",
    note="Each point is the slowest of several cycles. Stages in wall time, delays between processes in vehicle time.",
    series=(
        Series(label="deadline", table="latency", x="t_s", y="deadline_ms", colour=palette.LIMIT, style=Style.DOTTED),
        *(
            Series(label=label, table="latency", x="t_s", y=column, colour=colour)
            for label, column, colour in zip(
                ("predict", "linearise", "build", "solve", "publish"),
                ("predict_ms", "linearise_ms", "build_ms", "solve_ms", "publish_ms"),
                palette.STAGES,
                strict=True,
            )
        ),
        Series(
            label="age of estimate",
            table="latency",
            x="t_s",
            y="estimate_age_ms",
            colour=palette.ESTIMATE,
            style=Style.DASHED,
        ),
        Series(
            label="cycle to actuators",
            table="delivery",
            x="t_s",
            y="plan_ms",
            colour=palette.PLAN,
            style=Style.DASHED,
        ),
        Series(label="cycle", table="latency", x="t_s", y="cycle_ms", colour=palette.TRUTH, compared=True),
    ),
)

PLOTS = (TRACK, ERRORS, THRUST, CURRENT, DEPTH, TRACKING, LATENCY)
