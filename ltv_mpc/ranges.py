"""Where the numbers of every signal may lie: bounds of plausibility for any vehicle on earth, with their units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ltv_mpc.messages import (
    Acknowledged,
    AdcpPing,
    Applied,
    BottomTrack,
    Clock,
    ClockCommand,
    Command,
    CompassHeading,
    ControllerState,
    ControllerStatus,
    CurrentProfile,
    CycleTiming,
    Disturbance,
    DroppedNode,
    Estimate,
    EstimatorState,
    GnssFix,
    Handed,
    ImuSample,
    InboxEntry,
    Injection,
    InputReport,
    Kill,
    LblRange,
    LocalisationReport,
    Manual,
    ModelCheck,
    NodeStatus,
    Plan,
    PressureDepth,
    ReferenceStart,
    Rejected,
    RunEvent,
    SensorReport,
    Solve,
    StepRecord,
    TdcpFix,
    Truth,
    UsblFix,
)


class Range(NamedTuple):
    """Closed; every number of the field, be it one, a tuple or an array, must lie in it."""

    low: float
    high: float
    unit: str


EXACT = 2**53 - 1  # larger integers are not exact in JavaScript
TIME = Range(-(4 * 10**18), 4 * 10**18, "ns, 126 years either way: Unix time too")
DURATION = Range(0, EXACT, "ns")
INTERVAL = Range(1, EXACT, "ns")
COUNT = Range(0, EXACT, "a count or a hash below 2^53")
POSITIVE = Range(1, EXACT, "an integer")
MICROSECONDS = Range(0, 1e12, "us")
POSITION = Range(-1e6, 1e6, "m")
DEPTH = Range(-100, 12_000, "m")
LENGTH = Range(0, 1e9, "m")
PART = Range(0, 1, "a share")
SLANT_RANGE = Range(0, 10_000, "m")
SPEED = Range(-100, 100, "m/s")
CURRENT = Range(-20, 20, "m/s")
SD = Range(0, 1e6, "m/s")
WALK = Range(0, 1e6, "m/s per sqrt(s)")
TRAVEL_TIME = Range(0, 60, "s")
SHARE = Range(0, 1, "a share")
FACTOR = Range(0, 1e12, "a factor")
ANGLE = Range(-1e4, 1e4, "rad; headings may be unwrapped")
ANGULAR_RATE = Range(-100, 100, "rad/s")
SPECIFIC_FORCE = Range(-1e4, 1e4, "m/s2")
THRUST = Range(-1e6, 1e6, "N")
INJECTED = Range(-1e6, 1e6, "a share or s, as its harm has it")
MOMENT = Range(-1e6, 1e6, "N m")
STATE = Range(-1e6, 1e6, "m, m/s, rad, rad/s")
TIMES_REAL_TIME = Range(0.01, 1000, "vehicle seconds per second")
SCHEDULE = Range(0, 1e9, "s")
BELIEF = Range(-1e9, 1e9, "m, m/s, rad, rad/s, m/s2, a share")
ROTATION = Range(-1.0001, 1.0001, "an entry of a rotation matrix")
PRODUCTS = Range(-1e12, 1e12, "products in standard deviations of their noise")
VARIANCE = Range(-1e12, 1e12, "squares of m, m/s, rad, rad/s")
RESIDUAL = Range(0, 1e300, "finite also where a solve failed")
SEQUENCE_OR_NONE = Range(-1, EXACT, "-1 before the first")

RANGES: Mapping[type, dict[str, Range]] = {
    Truth: {
        "t_ns": TIME,
        "position_m": POSITION,
        "velocity_mps": SPEED,
        "attitude_rad": ANGLE,
        "water_velocity_mps": SPEED,
        "yaw_rate_radps": ANGULAR_RATE,
        "current_mps": CURRENT,
        "thrust_N": THRUST,
    },
    Disturbance: {"until_t_ns": TIME, "thrust_scale": SHARE, "force_N": THRUST, "yaw_moment_Nm": MOMENT},
    Injection: {"start_t_ns": TIME, "end_t_ns": TIME, "size": INJECTED, "seed": COUNT},
    Applied: {
        "t_ns": TIME,
        "thrust_N": THRUST,
        "command_N": THRUST,
        "command_slew_N_per_s": THRUST,
        "plan_epoch": COUNT,
        "plan_sequence": SEQUENCE_OR_NONE,
        "plan_cycle_t_ns": TIME,
        "plan_received_t_ns": TIME,
        "plans_late": COUNT,
        "plans_refused": COUNT,
    },
    ImuSample: {
        "t_ns": TIME,
        "interval_ns": INTERVAL,
        "angular_rate_radps": ANGULAR_RATE,
        "specific_force_mps2": SPECIFIC_FORCE,
    },
    GnssFix: {
        "t_ns": TIME,
        "north_m": POSITION,
        "east_m": POSITION,
        "velocity_north_mps": SPEED,
        "velocity_east_mps": SPEED,
    },
    TdcpFix: {"t_ns": TIME, "from_t_ns": TIME, "north_m": POSITION, "east_m": POSITION},
    AdcpPing: {"t_ns": TIME, "range_m": SLANT_RANGE},
    PressureDepth: {"t_ns": TIME, "depth_m": DEPTH},
    CompassHeading: {"t_ns": TIME, "heading_rad": ANGLE},
    BottomTrack: {"t_ns": TIME},
    LblRange: {"t_ns": TIME, "transponder": COUNT, "travel_time_s": TRAVEL_TIME},
    UsblFix: {"t_ns": TIME, "north_m": POSITION, "east_m": POSITION},
    SensorReport: {"used": COUNT, "nis": FACTOR, "last_t_ns": TIME},
    LocalisationReport: {"t_ns": TIME, "restarts": COUNT, "water_walk_mps_per_rts": WALK},
    CurrentProfile: {"depth_m": DEPTH, "north_mps": CURRENT, "east_mps": CURRENT, "sd_mps": SD},
    Estimate: {
        "t_ns": TIME,
        "north_m": POSITION,
        "east_m": POSITION,
        "heading_rad": ANGLE,
        "yaw_rate_radps": ANGULAR_RATE,
        "velocity_north_mps": SPEED,
        "velocity_east_mps": SPEED,
        "depth_m": DEPTH,
        "velocity_down_mps": SPEED,
        "covariance": VARIANCE,
    },
    Solve: {"iterations": COUNT, "primal_residual": RESIDUAL, "dual_residual": RESIDUAL},
    Plan: {
        "cycle_t_ns": TIME,
        "t_ns": TIME,
        "thrust_N": THRUST,
        "states": STATE,
        "estimate_t_ns": TIME,
        "expected_delay_ns": DURATION,
        "reference_m": POSITION,
        "reference_depth_m": DEPTH,
        "progress": PART,
        "cross_track_m": POSITION,
        "remaining_m": LENGTH,
    },
    Command: {"command_id": COUNT},
    Manual: {"thrust_N": THRUST},
    Acknowledged: {"t_ns": TIME, "command_id": COUNT},
    CycleTiming: {"t_ns": TIME, "compute_ns": DURATION, "compute_wall_ns": DURATION, "estimate_age_ns": TIME},
    Rejected: {"t_ns": TIME, "crc": COUNT},
    Handed: {"t_ns": TIME, "crc": COUNT},
    ReferenceStart: {
        "t_ns": TIME,
        "north_m": POSITION,
        "east_m": POSITION,
        "depth_m": DEPTH,
        "heading_rad": ANGLE,
        "velocity_mps": SPEED,
    },
    ControllerState: {
        "t_ns": TIME,
        "schedule_t_ns": TIME,
        "schedule_s": SCHEDULE,
        "schedule_rate": PART,
        "progress": PART,
        "depth_integral_N": THRUST,
        "plan_delays_ns": DURATION,
        "cycle_times_ns": DURATION,
        "model_products": PRODUCTS,
    },
    DroppedNode: {
        "node": COUNT,
        "velocity_mps": SPEED,
        "given": BELIEF,
        "regression": BELIEF,
        "covariance": VARIANCE,
        "with_position": VARIANCE,
        "position": VARIANCE,
        "walked": VARIANCE,
    },
    EstimatorState: {
        "t_ns": TIME,
        "settings": COUNT,
        "x": BELIEF,
        "attitude": ROTATION,
        "mounting": ROTATION,
        "covariance": VARIANCE,
        "epoch_t_ns": TIME,
        "first_node": COUNT,
        "seen_nodes": COUNT,
        "walked": VARIANCE,
        "restarts": COUNT,
    },
    InboxEntry: {"epoch": COUNT, "sequence": COUNT, "crc": COUNT, "received_t_ns": TIME},
    StepRecord: {"epoch": COUNT, "step": COUNT, "t_ns": TIME},
    Clock: {
        "clock_epoch": COUNT,
        "clock_sequence": COUNT,
        "at_monotonic_us": COUNT,
        "vehicle_ns": TIME,
        "speed_num": POSITIVE,
        "speed_den": POSITIVE,
        "asked_speed": POSITIVE,
    },
    NodeStatus: {
        "t_ns": TIME,
        "steps": COUNT,
        "published": COUNT,
        "received": COUNT,
        "dropped": COUNT,
        "rejected": COUNT,
        "step_us": MICROSECONDS,
        "behind_us": MICROSECONDS,
    },
    ControllerStatus: {
        "t_ns": TIME,
        "estimate_age_ns": TIME,
        "applied_age_ns": TIME,
        "cycle_median_us": MICROSECONDS,
        "cycle_p99_us": MICROSECONDS,
        "received": COUNT,
        "dropped": COUNT,
        "clock_error_ns": DURATION,
        "error_m": POSITION,
        "progress": SHARE,
    },
    InputReport: {"age_ns": TIME, "period_ns": DURATION, "refused": COUNT},
    ModelCheck: {
        "t_ns": TIME,
        "residual_N": THRUST,
        "residual_Nm": MOMENT,
        "evidence": FACTOR,
        "thrust_loss": SHARE,
    },
    ClockCommand: {"speed": TIMES_REAL_TIME},
    Kill: {},
    RunEvent: {"t_ns": TIME},
}
"""Every signal that travels, and where its numbers may lie. A field that is None has nothing to check."""
