"""Every message, one struct each: type, bounds, unit and meaning of each field.

Frames: world NED (north, east, down), body FRD (forward, starboard, down). SI units and radians, also on the wire.
Times: ``t_ns`` is vehicle time in integer nanoseconds, 0 at the start of the descent (negative while afloat before it).
Thrusts are in the order port, starboard, vertical (N). The signal's TYPE is the port: a node names the types it reads.
The key, rate, delivery and writer of each are in ``services/bus/topics.py``.

This is the only description of a message. ``validation.py`` compiles its checks from the annotations; the wire's
decoder, JSON Schemas, protocol page and recording channels come from them too. Each number has the quantity's bounds
(``ge``, ``le``) and unit; each field has a ``description``. An array is described by the list that it is on the wire:
``Meta(extra={"wire": list[list[Force]]})`` is a matrix of forces, and ``None`` in it is a missing value, NaN inside.
"""

from __future__ import annotations

import contextlib
import enum
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

Array: TypeAlias = npt.NDArray[np.float64]
Times: TypeAlias = npt.NDArray[np.int64]
Pair: TypeAlias = tuple[float, float]
Triple: TypeAlias = tuple[float, float, float]

# --- quantities: bounds of plausibility for any vehicle on earth; a vehicle's own limits (box, slew) belong to its node

MAX_EXACT_INTEGER = 2**53 - 1  # larger integers are not exact in JavaScript
MAX_TRAVEL_TIME_S = 60.0

# 126 years either way: Unix time too.
Time: TypeAlias = Annotated[int, Meta(ge=-(4 * 10**18), le=4 * 10**18, extra={"unit": "ns"})]
Duration: TypeAlias = Annotated[int, Meta(ge=0, le=MAX_EXACT_INTEGER, extra={"unit": "ns"})]
Interval: TypeAlias = Annotated[int, Meta(ge=1, le=MAX_EXACT_INTEGER, extra={"unit": "ns"})]
MonotonicTime: TypeAlias = Annotated[int, Meta(ge=0, le=MAX_EXACT_INTEGER, extra={"unit": "us"})]
WallTime: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e12, extra={"unit": "us"})]
WholeWallTime: TypeAlias = Annotated[int, Meta(ge=0, le=10**12, extra={"unit": "us"})]
ScheduleTime: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e9, extra={"unit": "s"})]
TravelTime: TypeAlias = Annotated[float, Meta(ge=0.0, le=MAX_TRAVEL_TIME_S, extra={"unit": "s"})]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=MAX_EXACT_INTEGER, extra={"unit": "count"})]
Index: TypeAlias = Annotated[int, Meta(ge=0, le=MAX_EXACT_INTEGER, extra={"unit": "index"})]
Identifier: TypeAlias = Annotated[int, Meta(ge=0, le=MAX_EXACT_INTEGER, extra={"unit": "identifier"})]
SequenceOrNone: TypeAlias = Annotated[int, Meta(ge=-1, le=MAX_EXACT_INTEGER, extra={"unit": "count"})]
PositiveInteger: TypeAlias = Annotated[int, Meta(ge=1, le=MAX_EXACT_INTEGER, extra={"unit": "integer"})]
Position: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "m"})]
Depth: TypeAlias = Annotated[float, Meta(ge=-100.0, le=12_000.0, extra={"unit": "m"})]
Length: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e9, extra={"unit": "m"})]
SlantRange: TypeAlias = Annotated[float, Meta(ge=0.0, le=10_000.0, extra={"unit": "m"})]
Speed: TypeAlias = Annotated[float, Meta(ge=-100.0, le=100.0, extra={"unit": "m/s"})]
WaterSpeed: TypeAlias = Annotated[float, Meta(ge=-20.0, le=20.0, extra={"unit": "m/s"})]
SpeedDeviation: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e6, extra={"unit": "m/s"})]
SpeedVariance: TypeAlias = Annotated[float, Meta(ge=-1e12, le=1e12, extra={"unit": "m2/s2"})]
RandomWalk: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e6, extra={"unit": "m/s per sqrt(s)"})]
Angle: TypeAlias = Annotated[float, Meta(ge=-1e4, le=1e4, extra={"unit": "rad"})]  # headings may be unwrapped
AngularRate: TypeAlias = Annotated[float, Meta(ge=-100.0, le=100.0, extra={"unit": "rad/s"})]
SpecificForce: TypeAlias = Annotated[float, Meta(ge=-1e4, le=1e4, extra={"unit": "m/s2"})]
Force: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "N"})]
ForceRate: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "N/s"})]
Moment: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "N m"})]
Share: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0, extra={"unit": "share"})]
Dimensionless: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e12, extra={"unit": "dimensionless"})]
SpeedOfTime: TypeAlias = Annotated[float, Meta(ge=0.01, le=1000.0, extra={"unit": "vehicle s per s"})]
MessageFaultSize: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "share or s"})]
# Finite also where a solve failed.
Residual: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e300, extra={"unit": "dimensionless"})]
VehicleState: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "m, m/s, rad, rad/s"})]
FilterState: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9, extra={"unit": "m, m/s, rad, rad/s, m/s2, share"})]
Covariance: TypeAlias = Annotated[float, Meta(ge=-1e12, le=1e12, extra={"unit": "squares of m, m/s, rad, rad/s"})]
RotationEntry: TypeAlias = Annotated[float, Meta(ge=-1.0001, le=1.0001, extra={"unit": "dimensionless"})]
ModelProduct: TypeAlias = Annotated[float, Meta(ge=-1e12, le=1e12, extra={"unit": "squares of noise deviations"})]
# A reference is parsed within a cycle.
ReferenceText: TypeAlias = Annotated[str, Meta(max_length=65_536)]
# A restarted process is given them by a pipe.
Durations: TypeAlias = Annotated[tuple[Duration, ...], Meta(max_length=1000)]

Positions: TypeAlias = tuple[Position, Position, Position]
Speeds: TypeAlias = tuple[Speed, Speed, Speed]
Angles: TypeAlias = tuple[Angle, Angle, Angle]
AngularRates: TypeAlias = tuple[AngularRate, AngularRate, AngularRate]
SpecificForces: TypeAlias = tuple[SpecificForce, SpecificForce, SpecificForce]
Forces: TypeAlias = tuple[Force, Force, Force]
ForceRates: TypeAlias = tuple[ForceRate, ForceRate, ForceRate]
Shares: TypeAlias = tuple[Share, Share, Share]

# --- arrays, each described by the list that it is on the wire; null in it is NaN inside ------------------------------

Depths: TypeAlias = Annotated[Array, Meta(extra={"wire": list[Depth]})]
SlantRanges: TypeAlias = Annotated[Array, Meta(extra={"wire": list[SlantRange]})]
SlantRangesOrNone: TypeAlias = Annotated[Array, Meta(extra={"wire": list[SlantRange | None]})]
BeamSpeeds: TypeAlias = Annotated[Array, Meta(extra={"wire": list[Speed | None]})]
BeamSpeedRows: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[Speed | None]]})]
WaterSpeeds: TypeAlias = Annotated[Array, Meta(extra={"wire": list[WaterSpeed]})]
SpeedDeviations: TypeAlias = Annotated[Array, Meta(extra={"wire": list[SpeedDeviation]})]
ForceRows: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[Force]]})]
VehicleStateRows: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[VehicleState]]})]
FilterStates: TypeAlias = Annotated[Array, Meta(extra={"wire": list[FilterState]})]
FilterStateRows: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[FilterState]]})]
Covariances: TypeAlias = Annotated[Array, Meta(extra={"wire": list[Covariance]})]
CovarianceMatrix: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[Covariance]]})]
RotationMatrix: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[RotationEntry]]})]
ModelProductMatrix: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[ModelProduct]]})]
Knots: TypeAlias = Annotated[Times, Meta(extra={"wire": list[Time]})]
Indices: TypeAlias = Annotated[Times, Meta(extra={"wire": list[Index]})]

# --- fields that mean the same in several messages -------------------------------------------------------------------

ValidityTime: TypeAlias = Annotated[Time, Meta(description="time of validity")]
PublicationTime: TypeAlias = Annotated[Time, Meta(description="time of publication")]
North: TypeAlias = Annotated[Position, Meta(description="position north of the origin")]
East: TypeAlias = Annotated[Position, Meta(description="position east of the origin")]
VelocityNorth: TypeAlias = Annotated[Speed, Meta(description="velocity over ground, north")]
VelocityEast: TypeAlias = Annotated[Speed, Meta(description="velocity over ground, east")]
YawRate: TypeAlias = Annotated[AngularRate, Meta(description="rate of turn about the down axis, positive to starboard")]
Crc: TypeAlias = Annotated[Identifier, Meta(description="CRC-32 of the payload")]
Publisher: TypeAlias = Annotated[str, Meta(description="node that publishes this")]
Key: TypeAlias = Annotated[str, Meta(description="key of the message, without the namespace")]
Why: TypeAlias = Annotated[str, Meta(description="reason in words; empty where there is none")]


class Message(msgspec.Struct, frozen=True, kw_only=True, eq=False, forbid_unknown_fields=True, gc=False):
    """A message. Arrays are numpy arrays inside and lists on the wire. Nothing in it leads back to it: it needs no
    collector of cycles.
    """


class Health(enum.StrEnum):
    """How well the inputs of the controller, or the plans of the actuators, keep up."""

    NOMINAL = "nominal"
    DEGRADED = "degraded"
    HOLD = "hold"
    FAILSAFE = "failsafe"


# --- the world: written by the plant, read by sensors, recorder and displays, never aboard ---------------------------


class Truth(Message, frozen=True, kw_only=True, eq=False):
    """The true state of the vehicle."""

    t_ns: ValidityTime
    position_m: Annotated[Positions, Meta(description="north, east, down")]
    velocity_mps: Annotated[Speeds, Meta(description="over ground: north, east, down")]
    attitude_rad: Annotated[Angles, Meta(description="roll, pitch, heading")]
    water_velocity_mps: Annotated[
        Speeds, Meta(description="through the water: surge, sway, heave, in the level heading frame")
    ]
    yaw_rate_radps: YawRate
    current_mps: Annotated[
        tuple[WaterSpeed, WaterSpeed], Meta(description="water at the vehicle over ground: north, east")
    ]
    thrust_N: Annotated[Forces, Meta(description="delivered: port, starboard, vertical")]


class Disturbance(Message, frozen=True, kw_only=True, eq=False):
    """What acts on the simulated vehicle besides water and propellers, from its arrival on until ``end_t_ns``.

    A new one takes the old one's place; nothing aboard reads it.
    """

    end_t_ns: Annotated[Time, Meta(description="vehicle time at which it ends")]
    thrust_scale: Annotated[
        Shares, Meta(description="delivered thrust over that of the propellers: port, starboard, vertical")
    ] = (1.0, 1.0, 1.0)
    force_N: Annotated[Forces, Meta(description="on the vehicle: north, east, down")] = (0.0, 0.0, 0.0)
    yaw_moment_Nm: Annotated[Moment, Meta(description="about down, positive to starboard")] = 0.0


class MessageFault(enum.StrEnum):
    """What may happen to a message on its way, where faults are injected."""

    LOSS = "loss"
    DELAY = "delay"
    REORDER = "reorder"  # it comes right after its successor
    DUPLICATE = "duplicate"
    CORRUPTION = "corruption"  # a few bits of the frame are turned
    NOT_A_NUMBER = "not_a_number"  # NaN or an infinity in one of its numbers
    STALE = "stale"  # its sender says again what it said before
    CLOCK_JUMP = "clock_jump"  # its stamps are those of a clock that has jumped


class Injection(Message, frozen=True, kw_only=True, eq=False):
    """A fault for the messages of one key, asked of `ltv-mpc inject`; nothing aboard reads it.

    ``size`` is the share of the messages that meets it; of "delay" seconds, of "clock_jump" seconds ahead of the time,
    of "stale" nothing.
    """

    key: Annotated[str, Meta(description="key of the messages that are harmed")]
    fault: Annotated[MessageFault, Meta(description="what happens to them")]
    start_t_ns: Annotated[Time, Meta(description="vehicle time at which it begins; immediately where that is past")]
    end_t_ns: Annotated[Time, Meta(description="vehicle time at which it ends")]
    size: Annotated[
        MessageFaultSize,
        Meta(description="share of the messages; delay: seconds; clock_jump: seconds ahead of the time; stale: unused"),
    ] = 1.0
    seed: Annotated[
        Identifier, Meta(description="seed of the random draws: which messages, which bits, which numbers")
    ] = 0


class Applied(Message, frozen=True, kw_only=True, eq=False):
    """What the thrusters do, and which plan they follow: the actuators' report to the controller."""

    t_ns: Annotated[Time, Meta(description="time of validity and of publication")]
    thrust_N: Annotated[Forces, Meta(description="delivered, after lag and saturation: port, starboard, vertical")]
    command_N: Annotated[Forces, Meta(description="command in force: port, starboard, vertical")]
    command_slew_N_per_s: Annotated[
        ForceRates, Meta(description="largest rate of change of the command since the last report; 0: unknown")
    ]
    plan_epoch: Annotated[Identifier, Meta(description="epoch of the newest accepted plan; 0 before the first")]
    plan_sequence: Annotated[
        SequenceOrNone, Meta(description="sequence of the newest accepted plan; -1 before the first")
    ]
    plan_cycle_t_ns: Annotated[Time, Meta(description="cycle_t_ns of the newest accepted plan; 0 before the first")]
    plan_received_t_ns: Annotated[Time, Meta(description="arrival of the newest accepted plan; 0 before the first")]
    plan_late: Annotated[bool, Meta(description="that plan arrived after its own first knot: a deadline miss")]
    plans_late: Annotated[Count, Meta(description="late plans so far")]
    plans_rejected: Annotated[
        Count, Meta(description="plans not followed so far: outside box or slew, out of order, of a second commander")
    ]
    health: Annotated[
        Health,
        Meta(description="how well plans keep up: degraded when two are missing, failsafe at the last one's end"),
    ] = Health.NOMINAL


# --- sensors ---------------------------------------------------------------------------------------------------------


class ImuSample(Message, frozen=True, kw_only=True, eq=False):
    """Increments of a strapdown IMU divided by the interval that ends at ``t_ns``: means over it, body frame."""

    t_ns: Annotated[Time, Meta(description="end of the interval")]
    interval_ns: Annotated[Interval, Meta(description="length of the interval")]
    angular_rate_radps: Annotated[AngularRates, Meta(description="mean over the interval: forward, starboard, down")]
    specific_force_mps2: Annotated[SpecificForces, Meta(description="mean over the interval: forward, starboard, down")]


class GnssFix(Message, frozen=True, kw_only=True, eq=False):
    """Position and velocity over ground, at the surface."""

    t_ns: ValidityTime
    north_m: North
    east_m: East
    velocity_north_mps: VelocityNorth
    velocity_east_mps: VelocityEast


class TdcpFix(Message, frozen=True, kw_only=True, eq=False):
    """Change of position between two epochs from time-differenced carrier phase, at the surface."""

    t_ns: ValidityTime
    from_t_ns: Annotated[Time, Meta(description="the earlier epoch")]
    north_m: Annotated[Position, Meta(description="change of position from the earlier epoch to t_ns, north")]
    east_m: Annotated[Position, Meta(description="change of position from the earlier epoch to t_ns, east")]


class AdcpPing(Message, frozen=True, kw_only=True, eq=False):
    """Velocity of the water relative to the transducer along each beam, positive away from the vehicle.

    ``range_m`` (K,) is the slant range of each cell's centre; ``beam_velocity_mps`` is (4, K); NaN (null on the wire)
    where a beam has no return.
    """

    t_ns: ValidityTime
    range_m: Annotated[SlantRanges, Meta(description="slant range of each cell's centre, increasing")]
    beam_velocity_mps: Annotated[
        BeamSpeedRows,
        Meta(description="4 x K, of the water along each beam, positive away from the vehicle; null: no return"),
    ]


class PressureDepth(Message, frozen=True, kw_only=True, eq=False):
    """Depth below the surface from pressure."""

    t_ns: ValidityTime
    depth_m: Annotated[Depth, Meta(description="depth below the surface")]


class CompassHeading(Message, frozen=True, kw_only=True, eq=False):
    """True heading from a magnetic compass, deviation and declination already taken off, (-pi, pi]."""

    t_ns: ValidityTime
    heading_rad: Annotated[Angle, Meta(description="true heading, corrected for deviation and declination")]


class BottomTrack(Message, frozen=True, kw_only=True, eq=False):
    """Velocity of the sea bed relative to the transducer along each beam, positive away from the vehicle.

    ``range_m`` (4,) is the slant range to the bottom; both are NaN (null on the wire) for a beam that has not found it.
    """

    t_ns: ValidityTime
    range_m: Annotated[SlantRangesOrNone, Meta(description="slant range to the bottom by beam; null: not found")]
    beam_velocity_mps: Annotated[
        BeamSpeeds, Meta(description="of the bottom along each beam, positive away from the vehicle; null: not found")
    ]


class LblRange(Message, frozen=True, kw_only=True, eq=False):
    """Two-way travel time to a transponder: half of it is a range, at the middle between interrogation and reply."""

    t_ns: Annotated[Time, Meta(description="middle between interrogation and reply")]
    transponder: Annotated[Index, Meta(description="index in the sensors file, from 0")]
    travel_time_s: Annotated[
        TravelTime, Meta(description="two-way travel time without the transponder's turn-around time")
    ]


class UsblFix(Message, frozen=True, kw_only=True, eq=False):
    """Position over ground that a ship measured acoustically and sent down; it arrives later than it is valid."""

    t_ns: ValidityTime
    north_m: North
    east_m: East


# --- aboard ----------------------------------------------------------------------------------------------------------


class CurrentProfile(Message, frozen=True, kw_only=True, eq=False):
    """Horizontal water velocity over depth; linear between depths, constant beyond both ends. All arrays (K,)."""

    depth_m: Annotated[Depths, Meta(description="K depths, increasing; linear between them, constant beyond both ends")]
    north_mps: Annotated[WaterSpeeds, Meta(description="velocity of the water over ground at each depth, north")]
    east_mps: Annotated[WaterSpeeds, Meta(description="velocity of the water over ground at each depth, east")]
    sd_mps: Annotated[
        SpeedDeviations | None, Meta(description="standard deviation of either component at each depth")
    ] = None


class Estimate(Message, frozen=True, kw_only=True, eq=False):
    """Where the vehicle is and how it moves over ground.

    ``covariance`` is (6, 6) over north, east (m), velocity north, east (m/s), heading (rad), yaw rate (rad/s).
    """

    t_ns: ValidityTime
    north_m: North
    east_m: East
    heading_rad: Annotated[Angle, Meta(description="true heading, clockwise from north; may be unwrapped")]
    yaw_rate_radps: YawRate
    velocity_north_mps: VelocityNorth
    velocity_east_mps: VelocityEast
    depth_m: Annotated[Depth | None, Meta(description="depth below the surface; left out by surface craft")] = None
    velocity_down_mps: Annotated[Speed | None, Meta(description="sinking speed; 0 is assumed without it")] = None
    covariance: Annotated[
        CovarianceMatrix | None,
        Meta(description="6 x 6 of north, east, velocity north, velocity east, heading, yaw rate"),
    ] = None
    current: Annotated[
        CurrentProfile | None, Meta(description="velocity of the water over depth, as far as it is known")
    ] = None

    @classmethod
    def at_rest(
        cls, *, north_m: float = 0.0, east_m: float = 0.0, heading_rad: float = 0.0, depth_m: float | None = None
    ) -> Estimate:
        """A vehicle that does not move over ground, at t = 0."""
        return cls(
            t_ns=0,
            north_m=north_m,
            east_m=east_m,
            heading_rad=heading_rad,
            yaw_rate_radps=0.0,
            velocity_north_mps=0.0,
            velocity_east_mps=0.0,
            depth_m=depth_m,
            velocity_down_mps=None if depth_m is None else 0.0,
        )


class FilterStatus(enum.StrEnum):
    """How far the localisation filter can be believed."""

    NOMINAL = "nominal"
    UNEXPECTED_CURRENT = "unexpected_current"  # water that nothing foretold: it has been granted a walk
    INCONSISTENT = "inconsistent"  # its innovations are larger or smaller than it says
    RESTARTED = "restarted"  # begun anew from its last good position, less than the grace time ago


class SensorStatus(enum.StrEnum):
    """What the filter thinks of one sensor."""

    OK = "ok"
    SILENT = "silent"  # nothing for several of its periods
    REJECTED = "rejected"  # most of what it says fails the innovation gate
    INCONSISTENT = "inconsistent"  # passes the gate, but its innovations are larger or smaller than said


class SensorReport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One sensor since the last report. ``nis``: mean over the window, per degree of freedom, before the gate."""

    sensor: Annotated[str, Meta(description="name in the sensors file")]
    status: Annotated[SensorStatus, Meta(description="the filter's verdict on the sensor")]
    used: Annotated[Count, Meta(description="scalar measurements that corrected the filter since the last report")]
    rejected: Annotated[
        dict[str, Count],
        Meta(description="measurements rejected since the last report, by reason: gate, late, no_return, ..."),
    ]
    nis: Annotated[
        Dimensionless | None,
        Meta(description="mean normalised innovation squared per degree of freedom, before the gate"),
    ]
    last_t_ns: Annotated[Time | None, Meta(description="time of validity of the newest message; null: none yet")]


class LocalisationReport(Message, frozen=True, kw_only=True, eq=False):
    """The localisation filter's word about itself and its sensors."""

    t_ns: ValidityTime
    status: Annotated[FilterStatus, Meta(description="how far the filter can be believed")]
    why: Annotated[str, Meta(description="reason of the status; empty while nominal")]
    restarts: Annotated[Count, Meta(description="restarts of the filter so far")]
    water_walk_mps_per_rts: Annotated[
        RandomWalk, Meta(description="random walk added to the water's, because innovations require it; 0: none")
    ]
    sensors: Annotated[tuple[SensorReport, ...], Meta(description="one report for each sensor")]


class PlanOrigin(enum.StrEnum):
    """Where a plan's thrusts come from: the rungs of the ladder, best first."""

    SOLVED = "solved"  # by the QP
    SHIFTED = "shifted"  # the previous plan, brought to the new grid
    ZERO = "zero"  # lateral thrusts to zero at the slew limit
    MANUAL = "manual"  # by hand: what the pilot's messages ask for, met at the slew limit


class SolveStatus(enum.StrEnum):
    """How a solve ended, one vocabulary for every solver."""

    SOLVED = "solved"
    ITERATION_LIMIT = "iteration_limit"
    INFEASIBLE = "infeasible"
    NON_FINITE = "non_finite"  # the solver returned NaN or infinity
    FAILED = "failed"
    NOT_RUN = "not_run"  # no solve was asked for


class Authority(enum.StrEnum):
    """Who commands the thrusters."""

    DISARMED = "disarmed"
    CONTROLLER = "controller"
    MANUAL = "manual"
    STOPPED = "stopped"


class Action(enum.StrEnum):
    """What an operator may ask of the controller."""

    ARM = "arm"  # the controller takes the thrusters; its reference begins anew
    DISARM = "disarm"  # thrusts to zero, until armed
    STOP = "stop"  # thrusts to zero from wherever it is, until armed
    MANUAL = "manual"  # the pilot takes the thrusters: they follow the ``manual`` messages
    RELEASE = "release"  # the pilot hands them back to the controller
    FOLLOW = "follow"  # another reference
    HOLD = "hold"  # the reference "here"


class InputReport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the controller knows of one input."""

    input: Annotated[str, Meta(description="key of the input")]
    alive: Annotated[bool, Meta(description="a message arrived lately")]
    valid: Annotated[bool, Meta(description="the newest message is current by its own stamp")]
    rate: Annotated[bool, Meta(description="at most half of the recent messages are missing")]
    age_ns: Annotated[Time | None, Meta(description="age of the newest message; null before the first")]
    period_ns: Annotated[Duration, Meta(description="median spacing of the stamps; 0 before the second")]
    rejected: Annotated[Count, Meta(description="messages not used so far: out of order or implausible")]


class Solve(Message, frozen=True, kw_only=True, eq=False):
    """The solver's account of one solve; residuals are those of the scaled problem."""

    status: Annotated[SolveStatus, Meta(description="how the solve ended")]
    iterations: Annotated[Count, Meta(description="iterations of the solver")] = 0
    primal_residual: Annotated[Residual, Meta(description="primal residual of the scaled problem")] = 0.0
    dual_residual: Annotated[Residual, Meta(description="dual residual of the scaled problem")] = 0.0
    why: Why = ""


class Plan(Message, frozen=True, kw_only=True, eq=False):
    """Thrusts to come: piecewise linear through knots, enough to run the actuators to its end without another word.

    ``t_ns`` (N+1,) knots; the plan takes effect at the first. ``thrust_N`` (N+1, 3) commands. ``states`` (N+1, 6)
    predicted n, e (m), u, v (m/s, relative to the water), heading (rad), yaw rate (rad/s).
    """

    cycle_t_ns: Annotated[Time, Meta(description="start of the cycle that made the plan")]
    t_ns: Annotated[Knots, Meta(description="N + 1 knots, increasing; the plan takes effect at the first")]
    thrust_N: Annotated[ForceRows, Meta(description="(N + 1) x 3, commands at the knots: port, starboard, vertical")]
    states: Annotated[
        VehicleStateRows,
        Meta(description="(N + 1) x 6, predicted: north, east, surge, sway (through the water), heading, yaw rate"),
    ]
    origin: Annotated[PlanOrigin, Meta(description="where the thrusts come from, best first")]
    solve: Annotated[Solve, Meta(description="the solver's account")]
    why: Annotated[str, Meta(description="reason of the origin, where it is not solved")] = ""
    authority: Annotated[Authority, Meta(description="who commands the thrusters")] = Authority.CONTROLLER
    health: Annotated[Health, Meta(description="how well the controller's inputs keep up")] = Health.NOMINAL
    estimate_t_ns: Annotated[Time, Meta(description="t_ns of the estimate that the plan is built on")] = 0
    expected_delay_ns: Annotated[Duration, Meta(description="from the start of the cycle to the first knot")] = 0
    reference_m: Annotated[
        tuple[Position, Position] | None,
        Meta(description="north, east of the target at the first knot; null before the reference"),
    ] = None
    reference_depth_m: Annotated[
        Depth | None, Meta(description="depth at which the reference ends; null where none is wanted")
    ] = None
    progress: Annotated[Share | None, Meta(description="share of the path behind the target")] = None
    cross_track_m: Annotated[
        Position | None, Meta(description="distance from the path at the first knot, positive to starboard")
    ] = None
    remaining_m: Annotated[Length | None, Meta(description="length of the path ahead of the target")] = None

    def thrust_at(self, t_ns: int) -> Array:
        """Commanded thrust (3,) at ``t_ns``, linear between knots, constant beyond both ends."""
        i = int(np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.t_ns) - 2))
        t0, t1 = int(self.t_ns[i]), int(self.t_ns[i + 1])
        s = min(max((t_ns - t0) / (t1 - t0), 0.0), 1.0)
        thrust: Array = self.thrust_N[i] + s * (self.thrust_N[i + 1] - self.thrust_N[i])
        return thrust


# --- who is in charge -------------------------------------------------------------------------------------------------


class Command(Message, frozen=True, kw_only=True, eq=False):
    """What an operator asks: answered by an ``Acknowledgement`` of the same ``command_id``."""

    command_id: Annotated[
        Identifier, Meta(description="the sender's choice, repeated in the answer; 48 random bits are unique")
    ]
    action: Annotated[Action, Meta(description="requested action")]
    reference_toml: Annotated[ReferenceText, Meta(description="for follow: contents of a reference file, TOML")] = ""


class Manual(Message, frozen=True, kw_only=True, eq=False):
    """Thrusts that a pilot asks for. They count for a second from their arrival, then the thrusters go to zero."""

    thrust_N: Annotated[
        Forces, Meta(description="wanted: port, starboard, vertical; valid for a second from its arrival")
    ]


class Acknowledgement(Message, frozen=True, kw_only=True, eq=False):
    """The controller's answer to a ``Command``."""

    t_ns: Annotated[Time, Meta(description="time of the controller's decision")]
    command_id: Annotated[Identifier, Meta(description="command_id of the command that this answers")]
    accepted: Annotated[bool, Meta(description="the command was carried out")]
    authority: Annotated[Authority, Meta(description="who commands the thrusters after it")]
    why: Annotated[str, Meta(description="reason of the refusal; empty where it was accepted")]


# --- how the run itself goes: times, records, faults -----------------------------------------------------------------


class CycleTiming(Message, frozen=True, kw_only=True, eq=False):
    """What one controller cycle cost, measured by whoever called it (zero work in lock step, where the delay is set).

    ``stage_us`` is wall time by name: predict, linearise, build, update, solve, read, publish. ``compute_ns`` is
    vehicle time from the start of the cycle to its plan's publication, ``compute_wall_ns`` the same on the wall.
    """

    t_ns: Annotated[Time, Meta(description="start of the cycle")]
    compute_ns: Annotated[Duration, Meta(description="from the start of the cycle to publication, vehicle time")]
    compute_wall_ns: Annotated[Duration, Meta(description="from the start of the cycle to publication, wall time")]
    estimate_age_ns: Annotated[Time, Meta(description="age of the estimate at the start of the cycle")]
    stage_us: Annotated[dict[str, WallTime], Meta(description="wall time by stage")]


class RejectedFrame(Message, frozen=True, kw_only=True, eq=False):
    """A frame that was refused at a node's door."""

    t_ns: Annotated[Time, Meta(description="time of arrival")]
    node: Publisher
    key: Key
    reason: Annotated[str, Meta(description="reason in words: the field and its bound")]
    crc: Crc
    payload_base64: Annotated[str, Meta(description="what arrived, at most 3072 bytes of it")]


class InjectorFrame(Message, frozen=True, kw_only=True, eq=False):
    """A frame between `ltv-mpc inject` and the node under test that is not what travels on its key for all others.

    What the node is given in the place of a message that was harmed, or what it said itself before that was harmed.
    """

    t_ns: Annotated[Time, Meta(description="time at which the injector received it")]
    key: Annotated[str, Meta(description="key on which the node under test was given it, or published it")]
    crc: Crc
    payload_base64: Annotated[str, Meta(description="the whole frame")]


class ReferenceStart(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where and when a reference began, and how the vehicle moved then."""

    t_ns: Annotated[Time, Meta(description="time at which the reference began")]
    north_m: North
    east_m: East
    depth_m: Annotated[Depth, Meta(description="depth below the surface")]
    heading_rad: Annotated[Angle, Meta(description="true heading, clockwise from north seen from above")]
    velocity_mps: Annotated[tuple[Speed, Speed], Meta(description="over ground: north, east")]


class ControllerState(Message, frozen=True, kw_only=True, eq=False):
    """State of a controller between two cycles: who is in charge, what is followed, the last plan, what was learned.

    The controller publishes it at each change of the first two, and every 5 s. A new controller that takes the place
    of a dead one is given it as its first message; its supervisor has put in the plan that is in force by then.
    """

    t_ns: PublicationTime
    authority: Annotated[Authority, Meta(description="who commands the thrusters")] = Authority.DISARMED
    reference_toml: Annotated[
        ReferenceText,
        Meta(description="reference that is followed, as a reference file holds it; empty: the one of the start"),
    ] = ""
    reference_start: Annotated[
        ReferenceStart | None, Meta(description="where the reference began; null before it is in force")
    ] = None
    schedule_t_ns: Annotated[Time, Meta(description="when schedule_s was right: the first knot of the last plan")] = 0
    schedule_s: Annotated[ScheduleTime, Meta(description="time of the target on the reference's own schedule")] = 0.0
    schedule_rate: Annotated[
        Share, Meta(description="rate of the schedule's time to the vehicle's; below 1 the target waits")
    ] = 1.0
    progress: Annotated[
        Share | None, Meta(description="share of the reference behind the target; null where it has no end")
    ] = None
    depth_integral_N: Annotated[
        Force, Meta(description="integral of the depth law: the vertical thrust that keeps a depth")
    ] = 0.0
    plan_delays_ns: Annotated[
        Durations, Meta(description="of the last plans: from the start of the cycle to arrival at the actuators")
    ] = ()
    cycle_times_ns: Annotated[Durations, Meta(description="of the last cycles: computing time alone")] = ()
    model_products: Annotated[
        ModelProductMatrix | None, Meta(description="4 x 4, summed: missing impulse, those of port, starboard, drag")
    ] = None
    plan: Annotated[
        Plan | None, Meta(description="last plan that was sent; after a restart, the one in force at the actuators")
    ] = None
    estimate: Annotated[Estimate | None, Meta(description="newest estimate")] = None


class DroppedGridPoint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of a depth whose water is no state any more: ``Link`` of ``localisation/column.py``, flat."""

    grid_point: Annotated[Index, Meta(description="index in the grid of depths, from 0 at the surface")]
    velocity_mps: Annotated[tuple[Speed, Speed], Meta(description="velocity of the water over ground: north, east")]
    conditioning_states: Annotated[
        FilterStates, Meta(description="q states at that time, to which the regression refers")
    ]
    regression: Annotated[FilterStateRows, Meta(description="2 x q, regression of the velocity on those states")]
    covariance: Annotated[CovarianceMatrix, Meta(description="2 x 2, covariance of the velocity given those states")]
    position_cross_covariance: Annotated[
        CovarianceMatrix, Meta(description="2 x 2, covariance of the velocity with the position")
    ]
    position_covariance: Annotated[
        CovarianceMatrix, Meta(description="2 x 2, covariance of the position given those states, at that time")
    ]
    walk_variance_m2ps2: Annotated[
        SpeedVariance, Meta(description="variance gained by the random walk up to that time")
    ]


class EstimatorState(Message, frozen=True, kw_only=True, eq=False):
    """State of the localisation filter: its belief, n states in the order of ``localisation/state.py``.

    ``covariance`` holds the lower triangle row by row, (n (n + 1) / 2,). Other settings of sensors or filter may mean
    other states, so a state belongs to the ``settings`` it was made with: their CRC-32. The estimator publishes it
    every 5 s; a new estimator that takes the place of a dead one is given it as its first message.
    """

    t_ns: ValidityTime
    settings_crc: Annotated[
        Identifier, Meta(description="CRC-32 of the settings of sensors and filter, with which alone it is valid")
    ]
    x: Annotated[FilterStates, Meta(description="n states, in the filter's order")]
    attitude: Annotated[RotationMatrix, Meta(description="3 x 3, body to north, east, down")]
    mounting: Annotated[RotationMatrix, Meta(description="3 x 3, profiler to body")]
    covariance: Annotated[
        Covariances, Meta(description="of the states: lower triangle, row by row, n (n + 1) / 2 numbers")
    ]
    epoch_t_ns: Annotated[Time, Meta(description="satellite epoch whose position is among the states")]
    first_grid_point: Annotated[Index, Meta(description="first depth of the window whose water is among the states")]
    measured_grid_points: Annotated[Indices, Meta(description="depths of the grid at which the profiler has measured")]
    dropped_grid_points: Annotated[
        tuple[DroppedGridPoint, ...], Meta(description="what is known of depths that are no states any more")
    ]
    walk_variance_m2ps2: Annotated[
        SpeedVariance, Meta(description="variance that each depth has gained by the random walk")
    ]
    restarts: Annotated[Count, Meta(description="restarts of the filter so far")]
    estimate: Annotated[Estimate | None, Meta(description="after a restart, the newest estimate")] = None


class InboxEntry(msgspec.Struct, frozen=True, array_like=False, kw_only=True, forbid_unknown_fields=True):
    """One entry of a step's inbox as the record keeps it: enough to find the frame again."""

    key: Key
    epoch: Annotated[Identifier, Meta(description="epoch of the message's header")]
    sequence: Annotated[Count, Meta(description="sequence of the message's header")]
    crc: Crc
    received_t_ns: Annotated[Time, Meta(description="time of arrival")]


class StepRecord(Message, frozen=True, kw_only=True, eq=False):
    """One step of one node, published before the step's outputs: what an exact replay needs."""

    node: Publisher
    epoch: Annotated[Identifier, Meta(description="start of the sender that this is, as in the header")]
    step: Annotated[Count, Meta(description="number of this node's step, from 0")]
    t_ns: Annotated[Time, Meta(description="time of the step")]
    cause: Annotated[str, Meta(description="grid, cycle, or the key of the message that caused the step")]
    inbox: Annotated[tuple[InboxEntry, ...], Meta(description="messages given to the step, in order")]


class ClockState(enum.StrEnum):
    """What vehicle time does."""

    WAITING = "waiting"
    RUNNING = "running"
    PAUSED = "paused"


class Clock(Message, frozen=True, kw_only=True, eq=False):
    """Vehicle time = vehicle_ns + (monotonic - at_monotonic) x speed_num / speed_den while running.

    Monotonic times are the host's CLOCK_MONOTONIC in microseconds: below 2^53 for 285 years, so every language reads
    them exactly.
    """

    clock_epoch: Annotated[Identifier, Meta(description="which start of the time-keeper this is")]
    clock_sequence: Annotated[Count, Meta(description="number of the announcement; a repetition keeps its number")]
    host_boot_id: Annotated[
        str, Meta(description="boot of the time-keeper's host, within which monotonic times are comparable")
    ]
    at_monotonic_us: Annotated[MonotonicTime, Meta(description="CLOCK_MONOTONIC from which this holds")]
    vehicle_ns: Annotated[Time, Meta(description="vehicle time at that instant")]
    speed_num: Annotated[PositiveInteger, Meta(description="speed in force, numerator")]
    speed_den: Annotated[PositiveInteger, Meta(description="speed in force, denominator")]
    requested_speed: Annotated[
        SpeedOfTime, Meta(description="requested vehicle seconds per wall second; a slow machine is given fewer")
    ]
    state: Annotated[ClockState, Meta(description="what vehicle time does from then on")]


class ClockCommand(Message, frozen=True, kw_only=True, eq=False):
    """How vehicle time shall go on, asked of the simulated vehicle that keeps it."""

    paused: Annotated[bool, Meta(description="vehicle time is to stand still")]
    speed: Annotated[SpeedOfTime, Meta(description="vehicle seconds per second of the wall")]


class ClockMode(enum.StrEnum):
    """By what a process knows the time."""

    SHARED = "shared"  # the ``clock`` topic, or a clock of its own that nobody else's stamps are held against
    TWO_WAY = "two-way"  # the other side's clock, by an exchange
    ONE_WAY = "one-way"  # the other side's clock, by its stamps alone: behind by an unknown delay


class NodeStatus(Message, frozen=True, kw_only=True, eq=False):
    """One process's word about itself: that it is ready, what it counts, what it waits for."""

    node: Publisher
    t_ns: PublicationTime
    ready: Annotated[bool, Meta(description="the node can do its work")]
    waiting_for: Annotated[str, Meta(description="what the node waits for, in words; empty where nothing")]
    steps: Annotated[Count, Meta(description="steps so far")]
    published: Annotated[Count, Meta(description="messages published so far, on all keys")]
    received: Annotated[Count, Meta(description="messages accepted so far")]
    dropped: Annotated[Count, Meta(description="messages that never arrived so far, by gaps in the sequences")]
    rejected: Annotated[Count, Meta(description="messages refused so far")]
    step_us: Annotated[WallTime, Meta(description="mean wall time of a step since the last status")]
    min_queue_delay_us: Annotated[
        WholeWallTime, Meta(description="least wall time that a message waited since the last status: a standing queue")
    ] = 0
    finished: Annotated[bool, Meta(description="the node has done all its work; this is its last status")] = False


class ControllerStatus(Message, frozen=True, kw_only=True, eq=False):
    """How the controller fares: its inputs, its cycles, who is in charge. Times are those of the last 10 s."""

    t_ns: PublicationTime
    estimate_age_ns: Annotated[Time | None, Meta(description="age of the newest estimate; null before the first")]
    applied_age_ns: Annotated[
        Time | None, Meta(description="age of the actuators' newest report; null: plans count as followed")
    ]
    cycle_median_us: Annotated[
        WallTime | None, Meta(description="from the start of a cycle to its plan, median of 10 s; null: no cycle")
    ]
    cycle_p99_us: Annotated[WallTime | None, Meta(description="99th percentile of the same")]
    received: Annotated[Count, Meta(description="messages accepted so far")]
    dropped: Annotated[Count, Meta(description="messages that never arrived so far, by gaps in the sequences")]
    rejected: Annotated[dict[str, Count], Meta(description="messages refused so far, by reason")]
    clock: Annotated[ClockMode, Meta(description="how the controller knows your time")]
    clock_error_ns: Annotated[
        Duration | None, Meta(description="bound of the clock's error; null: one-way, where it is unknown")
    ]
    authority: Annotated[Authority, Meta(description="who commands the thrusters")]
    health: Annotated[Health, Meta(description="how well the controller's inputs keep up")]
    error_m: Annotated[
        Position | None,
        Meta(description="horizontal, from the newest estimate to the reference; null: nothing is followed"),
    ]
    progress: Annotated[
        Share | None, Meta(description="share of the reference behind the target; null where it has no end")
    ] = None
    inputs: Annotated[tuple[InputReport, ...], Meta(description="inputs whose ages count")] = ()


class Kill(Message, frozen=True, kw_only=True, eq=False):
    """End one process of a simulation without warning, to see what the others do: asked of its launcher."""

    node: Annotated[str, Meta(description="node whose process is ended")]


class ModelCheck(Message, frozen=True, kw_only=True, eq=False):
    """How far the vehicle does what its model says: the motion from one estimate to the next, seen less foreseen."""

    t_ns: PublicationTime
    residual_N: Annotated[Force, Meta(description="surge force, observed minus predicted, mean since the last message")]
    residual_Nm: Annotated[
        Moment, Meta(description="yaw moment, observed minus predicted, mean since the last message")
    ]
    evidence: Annotated[
        Dimensionless, Meta(description="log-likelihood ratio of lost thrust, beyond what model mismatch explains")
    ]
    thrust_loss: Annotated[
        tuple[Share, Share], Meta(description="most likely lost share of the thrust: port, starboard")
    ]
    alarm: Annotated[bool, Meta(description="the vehicle does not move as its model says")]
    why: Annotated[str, Meta(description="reason of the alarm")]


class RunEvent(Message, frozen=True, kw_only=True, eq=False):
    """Something worth a mark on the time axis: a phase, a loss, a restart."""

    t_ns: Annotated[Time, Meta(description="time of the event")]
    node: Publisher
    kind: Annotated[str, Meta(description="one word")]
    text: Annotated[str, Meta(description="in words")]


def to_wire(value: Any) -> Any:
    """For encoders: numpy arrays as nested lists with null for NaN, numpy scalars as plain numbers."""
    if isinstance(value, np.ndarray):
        plain = value.tolist()
        if value.dtype.kind == "f" and np.isnan(value).any():
            plain = _null_for_nan(plain)
        return plain
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"{type(value).__name__} does not travel")


def _null_for_nan(plain: Any) -> Any:
    if isinstance(plain, list):
        return [_null_for_nan(x) for x in plain]
    return None if plain != plain else plain


def from_wire(kind: type, value: Any) -> Any:
    """For decoders: nested lists to float64 arrays (null to NaN), or int64 arrays where all are integers.

    Raises ``ValueError`` where the rows differ in length or an entry is no number.
    """
    if kind is not np.ndarray and getattr(kind, "__origin__", None) is not np.ndarray:
        raise NotImplementedError(f"{kind} does not travel")
    if getattr(kind, "__args__", (None, None))[1] == np.dtype[np.int64]:
        if not isinstance(value, list) or not all(type(x) is int for x in value):
            raise ValueError("expected a list of integers")
        return np.array(value, dtype=np.int64)
    if isinstance(value, list) and _all_numbers(value):
        with contextlib.suppress(ValueError):  # rows that differ in length
            return np.array(value, dtype=np.float64)  # null to NaN
    raise ValueError("expected a list of numbers, rows of one length")


_NUMBERS = {int, float, type(None)}


def _all_numbers(rows: list[Any]) -> bool:
    """Whether a list, or a list of such lists, holds numbers and null alone; true and false are none."""
    kinds = set(map(type, rows))
    return all(map(_all_numbers, rows)) if kinds == {list} else kinds <= _NUMBERS
