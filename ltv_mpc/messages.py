"""Messages on the bus: type, bounds, unit and meaning of each field.

Frames  world NED (north, east, down); body FRD (forward, starboard, down). SI units and radians, also on the wire.
Times   ``t_ns`` is vehicle time in integer nanoseconds, 0 at the start of the descent, negative while the vehicle is
        still afloat before it.
Thrusts in the order port, starboard, vertical (N).

A message's TYPE is the port: a node lists the types it reads and writes. ``services/bus/topics.py`` gives each type its
key, period, delivery and writer. The sections below follow the writer: plant, sensors, estimator, controller,
actuators, operator, every process, clock.

This file is the only description of the messages. ``validation.py`` compiles its checks from the annotations; the
decoder of the wire, the JSON Schemas, the protocol page and the channels of a recording also come from them. Each
number carries the bounds of its quantity (``ge``, ``le``) and its unit, each field a ``description``. An array is
annotated with the list that represents it on the wire: ``Meta(extra={"wire": list[list[Force]]})`` is a matrix of
forces. ``None`` in such a list is a missing value, which is NaN in the array.
"""

from __future__ import annotations

import enum
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

Array: TypeAlias = npt.NDArray[np.float64]
Times: TypeAlias = npt.NDArray[np.int64]
Pair: TypeAlias = tuple[float, float]
Triple: TypeAlias = tuple[float, float, float]

# --- quantities: bounds that hold for any vehicle on earth; the limits of one vehicle (box, slew) belong to its nodes

MAX_EXACT_INTEGER = 2**53 - 1
"""Largest integer that JavaScript represents exactly."""
MAX_TRAVEL_TIME_S = 60.0

# +-126 years: Unix time fits too.
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
Offset: TypeAlias = Annotated[float, Meta(ge=-100.0, le=100.0, extra={"unit": "m"})]
RandomWalk: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e6, extra={"unit": "m/s per sqrt(s)"})]
Angle: TypeAlias = Annotated[float, Meta(ge=-1e4, le=1e4, extra={"unit": "rad"})]  # headings may be unwrapped
AngularRate: TypeAlias = Annotated[float, Meta(ge=-100.0, le=100.0, extra={"unit": "rad/s"})]
SpecificForce: TypeAlias = Annotated[float, Meta(ge=-1e4, le=1e4, extra={"unit": "m/s2"})]
Force: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "N"})]
ForceRate: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "N/s"})]
Moment: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "N m"})]
Share: TypeAlias = Annotated[float, Meta(ge=0.0, le=1.0, extra={"unit": "share"})]
ThrustShare: TypeAlias = Annotated[float, Meta(ge=0.1, le=1.0, extra={"unit": "share"})]
Dimensionless: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e12, extra={"unit": "dimensionless"})]
SpeedOfTime: TypeAlias = Annotated[float, Meta(ge=0.01, le=1000.0, extra={"unit": "vehicle s per s"})]
Voltage: TypeAlias = Annotated[float, Meta(ge=0.0, le=10_000.0, extra={"unit": "V"})]
# Finite even if the solve failed.
Residual: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e300, extra={"unit": "dimensionless"})]
VehicleState: TypeAlias = Annotated[float, Meta(ge=-1e6, le=1e6, extra={"unit": "m, m/s, rad, rad/s"})]
FilterState: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9, extra={"unit": "m, m/s, rad, rad/s, m/s2, share"})]
Covariance: TypeAlias = Annotated[float, Meta(ge=-1e12, le=1e12, extra={"unit": "squares of m, m/s, rad, rad/s"})]
Innovation: TypeAlias = Annotated[float, Meta(ge=-1e9, le=1e9, extra={"unit": "m, m/s or rad"})]
InnovationDeviation: TypeAlias = Annotated[float, Meta(ge=0.0, le=1e9, extra={"unit": "m, m/s or rad"})]
RotationEntry: TypeAlias = Annotated[float, Meta(ge=-1.0001, le=1.0001, extra={"unit": "dimensionless"})]
ModelProduct: TypeAlias = Annotated[float, Meta(ge=-1e12, le=1e12, extra={"unit": "squares of noise deviations"})]
# Bounded because a reference is parsed within a control cycle.
ReferenceText: TypeAlias = Annotated[str, Meta(max_length=65_536)]
SourceName: TypeAlias = Annotated[str, Meta(pattern="^[a-z0-9][a-z0-9_-]{0,31}$")]
SourceChoice: TypeAlias = Annotated[str, Meta(pattern="^([a-z0-9][a-z0-9_-]{0,31})?$")]
# Bounded because a restarted process receives them through a pipe.
Durations: TypeAlias = Annotated[tuple[Duration, ...], Meta(max_length=1000)]

Positions: TypeAlias = tuple[Position, Position, Position]
Speeds: TypeAlias = tuple[Speed, Speed, Speed]
Angles: TypeAlias = tuple[Angle, Angle, Angle]
AngularRates: TypeAlias = tuple[AngularRate, AngularRate, AngularRate]
SpecificForces: TypeAlias = tuple[SpecificForce, SpecificForce, SpecificForce]
Forces: TypeAlias = tuple[Force, Force, Force]
ForceRates: TypeAlias = tuple[ForceRate, ForceRate, ForceRate]
Shares: TypeAlias = tuple[Share, Share, Share]

# --- arrays, annotated with the list that represents them on the wire; null on the wire is NaN in the array ----------

Depths: TypeAlias = Annotated[Array, Meta(extra={"wire": list[Depth]})]
SlantRanges: TypeAlias = Annotated[Array, Meta(extra={"wire": list[SlantRange]})]
SlantRangesOrNone: TypeAlias = Annotated[Array, Meta(extra={"wire": list[SlantRange | None]})]
BeamSpeeds: TypeAlias = Annotated[Array, Meta(extra={"wire": list[Speed | None]})]
BeamSpeedRows: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[Speed | None]]})]
WaterSpeeds: TypeAlias = Annotated[Array, Meta(extra={"wire": list[WaterSpeed]})]
SpeedDeviations: TypeAlias = Annotated[Array, Meta(extra={"wire": list[SpeedDeviation]})]
PositionRows: TypeAlias = Annotated[Array, Meta(extra={"wire": list[list[Position]]})]
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

# --- fields with the same meaning in several messages ----------------------------------------------------------------

ValidityTime: TypeAlias = Annotated[Time, Meta(description="time of validity")]
PublicationTime: TypeAlias = Annotated[Time, Meta(description="time of publication")]
North: TypeAlias = Annotated[Position, Meta(description="position north of the origin")]
East: TypeAlias = Annotated[Position, Meta(description="position east of the origin")]
VelocityNorth: TypeAlias = Annotated[Speed, Meta(description="velocity over ground, north")]
VelocityEast: TypeAlias = Annotated[Speed, Meta(description="velocity over ground, east")]
YawRate: TypeAlias = Annotated[AngularRate, Meta(description="rate of turn about the down axis, positive to starboard")]
HealthReason: TypeAlias = Annotated[str, Meta(description="reason of the health; empty if it is nominal")]
Arrived: TypeAlias = Annotated[
    bool, Meta(description="the vehicle has come to the end of the reference, and not its target alone")
]
ReferenceProgress: TypeAlias = Annotated[
    Share | None, Meta(description="completed share of the reference; null if the reference has no end")
]
Crc: TypeAlias = Annotated[Identifier, Meta(description="CRC-32 of the payload")]
Publisher: TypeAlias = Annotated[str, Meta(description="node that publishes this message")]
Key: TypeAlias = Annotated[str, Meta(description="key of the message, without the namespace")]


class Message(msgspec.Struct, frozen=True, kw_only=True, eq=False, forbid_unknown_fields=True, gc=False):
    """Base class of all messages. Arrays are numpy arrays in memory and lists on the wire.

    ``gc=False``: no field of a message can refer back to it, so the cycle collector need not track it.
    """


class Health(enum.StrEnum):
    """Timeliness of inputs: of the estimates for the controller, of the plans for the actuators."""

    NOMINAL = "nominal"  # the inputs arrive in time
    DEGRADED = "degraded"  # the controller continues from its prediction, the actuators follow the last plan
    HOLD = "hold"  # the controller stops the vehicle through the water and holds the depth
    FAILSAFE = "failsafe"  # no lateral thrust, the vertical thrust is failsafe_vertical_N


class MissionAction(enum.StrEnum):
    """Action of the mission policy. ``ltv_mpc/safety/mission_policy.py`` has the causes."""

    GO_ON = "go on"  # the reference is followed
    HOLD = "hold"  # the position is held, the reference waits
    SURFACE = "surface"  # the failsafe of the vehicle: no lateral thrust, failsafe_vertical_N


# --- written by the plant of a simulation: the true state; no process aboard the vehicle reads it ---------------------


class Truth(Message, frozen=True, kw_only=True, eq=False):
    """True state of the simulated vehicle."""

    t_ns: ValidityTime
    position_m: Annotated[Positions, Meta(description="north, east, down")]
    velocity_mps: Annotated[Speeds, Meta(description="over ground: north, east, down")]
    attitude_rad: Annotated[Angles, Meta(description="roll, pitch, heading")]
    water_velocity_mps: Annotated[
        Speeds, Meta(description="velocity through the water: surge, sway, heave, in the level heading frame")
    ]
    yaw_rate_radps: YawRate
    current_mps: Annotated[
        tuple[WaterSpeed, WaterSpeed], Meta(description="velocity of the water at the vehicle over ground: north, east")
    ]
    thrust_N: Annotated[Forces, Meta(description="delivered: port, starboard, vertical")]


# --- written by the sensors, read by the estimator -------------------------------------------------------------------


class ImuSample(Message, frozen=True, kw_only=True, eq=False):
    """Mean angular rate and specific force of a strapdown IMU, in the body frame.

    Each is the increment over the interval that ends at ``t_ns``, divided by the length of that interval.
    """

    t_ns: Annotated[Time, Meta(description="end of the interval")]
    interval_ns: Annotated[Interval, Meta(description="length of the interval")]
    angular_rate_radps: Annotated[AngularRates, Meta(description="mean over the interval: forward, starboard, down")]
    specific_force_mps2: Annotated[SpecificForces, Meta(description="mean over the interval: forward, starboard, down")]


class ImuSamples(Message, frozen=True, kw_only=True, eq=False):
    """Samples of a strapdown IMU since the last message; a driver that has one at a time publishes one."""

    samples: Annotated[
        tuple[ImuSample, ...], Meta(min_length=1, max_length=1000, description="in order of time, each with its own")
    ]

    @property
    def t_ns(self) -> int:
        """Time of the newest sample (ns)."""
        return self.samples[-1].t_ns


class GnssFix(Message, frozen=True, kw_only=True, eq=False):
    """Position and velocity over ground from satellite navigation, at the surface."""

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

    ``range_m`` (K,) is the slant range to the centre of each cell. ``beam_velocity_mps`` is (4, K); it is NaN (null on
    the wire) where a beam has no return.
    """

    t_ns: ValidityTime
    range_m: Annotated[SlantRanges, Meta(description="slant range to the centre of each cell, increasing")]
    beam_velocity_mps: Annotated[
        BeamSpeedRows,
        Meta(description="4 x K, of the water along each beam, positive away from the vehicle; null: no return"),
    ]


class PressureDepth(Message, frozen=True, kw_only=True, eq=False):
    """Depth below the surface from pressure."""

    t_ns: ValidityTime
    depth_m: Annotated[Depth, Meta(description="depth below the surface")]


class CompassHeading(Message, frozen=True, kw_only=True, eq=False):
    """True heading from a magnetic compass, corrected for deviation and declination, in (-pi, pi]."""

    t_ns: ValidityTime
    heading_rad: Annotated[Angle, Meta(description="true heading, corrected for deviation and declination")]


class BottomTrack(Message, frozen=True, kw_only=True, eq=False):
    """Velocity of the sea bed relative to the transducer along each beam, positive away from the vehicle.

    ``range_m`` (4,) is the slant range to the bottom. Both fields are NaN (null on the wire) for a beam without a
    bottom return.
    """

    t_ns: ValidityTime
    range_m: Annotated[SlantRangesOrNone, Meta(description="slant range to the bottom by beam; null: no return")]
    beam_velocity_mps: Annotated[
        BeamSpeeds, Meta(description="of the bottom along each beam, positive away from the vehicle; null: no return")
    ]


class LblRange(Message, frozen=True, kw_only=True, eq=False):
    """Two-way travel time to a transponder of a long baseline.

    Half of it is the range, valid at the middle between interrogation and reply.
    """

    t_ns: Annotated[Time, Meta(description="middle between interrogation and reply")]
    transponder: Annotated[Index, Meta(description="index in the sensors file, from 0")]
    travel_time_s: Annotated[
        TravelTime, Meta(description="two-way travel time, without the turn-around time of the transponder")
    ]


class UsblFix(Message, frozen=True, kw_only=True, eq=False):
    """Position over ground that a ship measured acoustically and sent down. It arrives after its time of validity."""

    t_ns: ValidityTime
    north_m: North
    east_m: East


# --- written by the estimator: the estimate for the controller, a report for people, its state for a restart ---------


class CurrentProfile(Message, frozen=True, kw_only=True, eq=False):
    """Horizontal water velocity over depth: linear between the depths, constant beyond both ends. Arrays are (K,)."""

    depth_m: Annotated[Depths, Meta(description="K depths, increasing; linear between them, constant beyond both ends")]
    north_mps: Annotated[WaterSpeeds, Meta(description="velocity of the water over ground at each depth, north")]
    east_mps: Annotated[WaterSpeeds, Meta(description="velocity of the water over ground at each depth, east")]
    sd_mps: Annotated[
        SpeedDeviations | None, Meta(description="standard deviation of either component at each depth")
    ] = None


class Estimate(Message, frozen=True, kw_only=True, eq=False):
    """Estimated position and motion of the vehicle over ground, at the reference point that its file declares.

    ``covariance`` is (6, 6) over north, east (m), velocity north, east (m/s), heading (rad), yaw rate (rad/s).
    """

    t_ns: ValidityTime
    north_m: North
    east_m: East
    heading_rad: Annotated[Angle, Meta(description="true heading, clockwise from north; may be unwrapped")]
    yaw_rate_radps: YawRate
    velocity_north_mps: VelocityNorth
    velocity_east_mps: VelocityEast
    depth_m: Annotated[Depth | None, Meta(description="depth below the surface; omitted by surface craft")] = None
    velocity_down_mps: Annotated[Speed | None, Meta(description="sinking speed; 0 is assumed if omitted")] = None
    altitude_m: Annotated[SlantRange | None, Meta(description="height above the bottom; omitted if it is not seen")] = (
        None
    )
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
        """Return the estimate of a vehicle at rest over ground at t = 0.

        Parameters
        ----------
        north_m, east_m : position (m).
        heading_rad : true heading (rad), clockwise from north.
        depth_m : depth below the surface (m), or None for surface craft.
        """
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
    """Consistency of the localisation filter."""

    NOMINAL = "nominal"
    UNEXPECTED_CURRENT = "unexpected_current"  # the current changes unpredicted: its process noise is inflated
    INCONSISTENT = "inconsistent"  # innovations larger or smaller than their covariance
    RESTARTED = "restarted"  # reinitialised from the last good position, within the grace time


class SensorStatus(enum.StrEnum):
    """Consistency of one sensor with the localisation filter."""

    OK = "ok"
    SILENT = "silent"  # no message for several of its periods
    REJECTED = "rejected"  # most of its measurements fail the innovation gate
    INCONSISTENT = "inconsistent"  # passes the gate, but its innovations do not match their covariance


class SensorReport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Use of one sensor by the filter since the last report.

    ``nis`` is the mean over the window, per degree of freedom, before the gate.
    """

    sensor: Annotated[str, Meta(description="name in the sensors file")]
    status: Annotated[SensorStatus, Meta(description="consistency of the sensor with the filter")]
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


class InnovationSample(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Innovations of one message of a sensor that passed the gate: measurement minus its prediction by the filter."""

    sensor: Annotated[str, Meta(description="name in the sensors file")]
    t_ns: ValidityTime
    rows: Annotated[
        tuple[Index, ...],
        Meta(
            description="index of each measurement in its message; gnss: 0, 1 position, 2, 3 velocity; lbl: transponder"
        ),
    ]
    innovations: Annotated[tuple[Innovation, ...], Meta(description="in the unit of the measurement")]
    sd: Annotated[tuple[InnovationDeviation, ...], Meta(description="standard deviation that the filter expects")]


class LocalisationReport(Message, frozen=True, kw_only=True, eq=False):
    """Health report of the localisation filter and its sensors."""

    t_ns: ValidityTime
    status: Annotated[FilterStatus, Meta(description="consistency of the filter")]
    why: Annotated[str, Meta(description="reason of the status; empty while nominal")]
    restarts: Annotated[Count, Meta(description="restarts of the filter so far")]
    water_walk_mps_per_rts: Annotated[
        RandomWalk,
        Meta(description="random walk added to that of the current because the innovations require it; 0: none"),
    ]
    sensors: Annotated[tuple[SensorReport, ...], Meta(description="one report for each sensor")]
    innovations: Annotated[
        tuple[InnovationSample, ...],
        Meta(description="at most four innovations of the newest message of each sensor since the last report"),
    ] = ()


class DroppedGridPoint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Conditional distribution of the current at a depth that left the state vector of the filter.

    ``localisation/water/column.py`` has its equation.
    """

    grid_point: Annotated[Index, Meta(description="index in the depth grid, from 0 at the surface")]
    velocity_mps: Annotated[tuple[Speed, Speed], Meta(description="velocity of the water over ground: north, east")]
    conditioning_states: Annotated[
        FilterStates, Meta(description="q states at that time, on which the velocity is conditioned")
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
        SpeedVariance, Meta(description="variance gained through the random walk up to that time")
    ]


class EstimatorState(Message, frozen=True, kw_only=True, eq=False):
    """State of the localisation filter, n states in the order of ``localisation/filter/state.py``.

    The state vector depends on the settings of sensors and filter, so a state is valid only with the settings whose
    CRC-32 is ``settings_crc``. The estimator publishes its state every 5 s. An estimator that replaces a dead one
    receives the newest state as its first message.
    """

    t_ns: ValidityTime
    settings_crc: Annotated[
        Identifier, Meta(description="CRC-32 of the settings of sensors and filter; the state is valid only with them")
    ]
    x: Annotated[FilterStates, Meta(description="n states, in the order of the filter")]
    attitude: Annotated[RotationMatrix, Meta(description="3 x 3, body to north, east, down")]
    mounting: Annotated[RotationMatrix, Meta(description="3 x 3, profiler to body")]
    covariance: Annotated[
        Covariances, Meta(description="of the states: lower triangle, row by row, n (n + 1) / 2 numbers")
    ]
    epoch_t_ns: Annotated[Time, Meta(description="satellite epoch whose position is among the states")]
    first_grid_point: Annotated[
        Index, Meta(description="first point of the depth grid whose current is among the states")
    ]
    measured_grid_points: Annotated[
        Indices, Meta(description="points of the depth grid at which the profiler has measured")
    ]
    dropped_grid_points: Annotated[
        tuple[DroppedGridPoint, ...], Meta(description="conditional distributions of grid points that left the states")
    ]
    walk_variance_m2ps2: Annotated[
        SpeedVariance, Meta(description="variance that each grid point has gained through the random walk")
    ]
    restarts: Annotated[Count, Meta(description="restarts of the filter so far")]
    estimate: Annotated[
        Estimate | None, Meta(description="newest published estimate, which the supervisor adds for a restart")
    ] = None


# --- written by the controller: plans, replies to commands, its status, its state for a restart ----------------------


class PlanOrigin(enum.StrEnum):
    """Origin of the thrusts of a plan: the fallback levels, best first."""

    SOLVED = "solved"  # by the QP
    SHIFTED = "shifted"  # the previous plan, resampled on the new grid
    STOP = "stop"  # lateral thrusts that stop the vehicle through the water
    ZERO = "zero"  # lateral thrusts to zero at the slew limit
    MANUAL = "manual"  # thrusts of the pilot, reached at the slew limit


class SolveStatus(enum.StrEnum):
    """Outcome of a solve, the same words for every solver."""

    SOLVED = "solved"
    ITERATION_LIMIT = "iteration_limit"
    INFEASIBLE = "infeasible"
    NON_FINITE = "non_finite"  # the solver returned NaN or infinity
    FAILED = "failed"
    NOT_RUN = "not_run"  # this cycle does not solve


class Authority(enum.StrEnum):
    """Source of the thrust commands."""

    DISARMED = "disarmed"  # no thruster is driven
    CONTROLLER = "controller"  # the plans of the controller
    MANUAL = "manual"  # a pilot
    STOPPED = "stopped"  # no thruster is driven; only the command arm leads out of it


class Obstacle(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Moving obstacle: it is predicted at constant velocity, and its uncertainty grows with its age."""

    id: Annotated[Identifier, Meta(description="a later report with this id replaces this one")]
    t_ns: ValidityTime
    north_m: North
    east_m: East
    velocity_north_mps: VelocityNorth
    velocity_east_mps: VelocityEast
    radius_m: Annotated[Length, Meta(description="of a circle around it")]
    covariance_m2: Annotated[
        tuple[Covariance, Covariance, Covariance],
        Meta(description="of its position: north-north, north-east, east-east"),
    ] = (0.0, 0.0, 0.0)


class Solve(Message, frozen=True, kw_only=True, eq=False):
    """Result of one solve; residuals are those of the scaled problem."""

    status: Annotated[SolveStatus, Meta(description="outcome of the solve")]
    iterations: Annotated[Count, Meta(description="iterations of the solver")] = 0
    primal_residual: Annotated[Residual, Meta(description="primal residual of the scaled problem")] = 0.0
    dual_residual: Annotated[Residual, Meta(description="dual residual of the scaled problem")] = 0.0
    why: Annotated[str, Meta(description="reason of a failure; empty if there is none")] = ""


class FenceReport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Zones of the fence and obstacles beside a plan. Distances are between the hull and the boundary."""

    clearance_m: Annotated[
        Position | None, Meta(description="least distance from a zone or obstacle over the plan; negative: inside")
    ]
    nearest: Annotated[str, Meta(description="label of that zone or obstacle; empty if there is none")] = ""
    active: Annotated[tuple[str, ...], Meta(description="zones and obstacles that bound the plan")] = ()
    in_margin: Annotated[tuple[str, ...], Meta(description="those whose margin the hull is in at the first knot")] = ()
    inside: Annotated[tuple[str, ...], Meta(description="those that the hull is in at the first knot")] = ()
    exceeded: Annotated[
        Count, Meta(description="knots that lack more than 1 cm of a required clearance, of all zones and obstacles")
    ] = 0
    skipped_m: Annotated[Length, Meta(description="length of the path that is left out: zones and margins")] = 0.0
    no_way: Annotated[bool, Meta(description="no way round the zones leads to the target")] = False
    time_to_zone_ns: Annotated[
        Duration | None,
        Meta(
            description="from the first knot until the hull is in a zone or obstacle; null: not within the plan, nor "
            "within 10 minutes of drift after a plan that is not solved"
        ),
    ] = None
    dropped: Annotated[
        tuple[Identifier, ...],
        Meta(description="obstacles of which a report was dropped in this cycle: too old, or ahead of vehicle time"),
    ] = ()


class Plan(Message, frozen=True, kw_only=True, eq=False):
    """Future thrusts, piecewise linear between knots. Without another plan the actuators follow it for a while.

    ``t_ns`` (N+1,) are the knots; the plan takes effect at the first. ``thrust_N`` (N+1, 3) are the commands at the
    knots. ``states`` (N+1, 6) are the predicted n, e (m), u, v (m/s, through the water), heading (rad), yaw rate
    (rad/s). States and target are those of the vehicle's reference point, as the estimates are.
    """

    cycle_t_ns: Annotated[Time, Meta(description="start of the cycle that computed the plan")]
    t_ns: Annotated[Knots, Meta(description="N + 1 knots, increasing; the plan takes effect at the first")]
    thrust_N: Annotated[ForceRows, Meta(description="(N + 1) x 3, commands at the knots: port, starboard, vertical")]
    states: Annotated[
        VehicleStateRows,
        Meta(description="(N + 1) x 6, predicted: north, east, surge, sway (through the water), heading, yaw rate"),
    ]
    origin: Annotated[PlanOrigin, Meta(description="origin of the thrusts, best first")]
    solve: Annotated[Solve, Meta(description="result of the solve")]
    why: Annotated[str, Meta(description="reason of the origin, if it is not solved; else what is missing")] = ""
    authority: Annotated[Authority, Meta(description="source of the thrust commands")] = Authority.CONTROLLER
    health: Annotated[Health, Meta(description="timeliness of the inputs of the controller")] = Health.NOMINAL
    health_why: HealthReason = ""
    estimate_t_ns: Annotated[Time, Meta(description="t_ns of the estimate on which the plan is based")] = 0
    expected_delay_ns: Annotated[Duration, Meta(description="from the start of the cycle to the first knot")] = 0
    reference_m: Annotated[
        tuple[Position, Position] | None,
        Meta(description="north, east of the target at the first knot; null before the reference starts"),
    ] = None
    reference_depth_m: Annotated[
        Depth | None, Meta(description="depth at which the reference ends; null if it has no depth")
    ] = None
    reference_heading_rad: Annotated[Angle | None, Meta(description="heading wanted at a point; null: it is free")] = (
        None
    )
    depth_limit_m: Annotated[
        Depth | None, Meta(description="depth limit that keeps the vehicle from the depth of the reference; null: none")
    ] = None
    progress: Annotated[Share | None, Meta(description="share of the path that the target has completed")] = None
    cross_track_m: Annotated[
        Position | None, Meta(description="distance from the path at the first knot, positive to starboard")
    ] = None
    remaining_m: Annotated[Length | None, Meta(description="length of the path ahead of the target")] = None
    arrived: Arrived = False
    delivered_N: Annotated[
        tuple[Force, Force, Force] | None,
        Meta(description="predicted thrust of port, starboard and vertical at the first knot; null: unknown"),
    ] = None
    fence: Annotated[
        FenceReport | None, Meta(description="zones and obstacles beside the plan; null: no fence and no obstacle")
    ] = None

    @property
    def initial_thrust_N(self) -> Triple:
        """Predicted thrust of port, starboard and vertical at the first knot (N); its command where it is unknown."""
        port, starboard, vertical = self.thrust_N[0].tolist() if self.delivered_N is None else self.delivered_N
        return port, starboard, vertical

    def thrust_at(self, t_ns: int) -> Array:
        """Return the commanded thrust (3,) in N at ``t_ns``: linear between knots, constant beyond both ends.

        Parameters
        ----------
        t_ns : time (ns).
        """
        i = int(np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.t_ns) - 2))
        t0, t1 = int(self.t_ns[i]), int(self.t_ns[i + 1])
        s = min(max((t_ns - t0) / (t1 - t0), 0.0), 1.0)
        thrust: Array = self.thrust_N[i] + s * (self.thrust_N[i + 1] - self.thrust_N[i])
        return thrust


class Acknowledgement(Message, frozen=True, kw_only=True, eq=False):
    """Reply of the controller to a ``Command``."""

    t_ns: Annotated[Time, Meta(description="time of the decision")]
    command_id: Annotated[Identifier, Meta(description="command_id of the command")]
    accepted: Annotated[bool, Meta(description="the command was carried out")]
    authority: Annotated[Authority, Meta(description="source of the thrust commands after it")]
    why: Annotated[str, Meta(description="reason of the rejection; empty if the command was accepted")]
    warnings: Annotated[
        tuple[str, ...], Meta(description="of an accepted command: what it skipped, could not check or does not end")
    ] = ()


class ZoneInForce(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Zone of the fence in force, in the local frame."""

    label: Annotated[str, Meta(max_length=200, description="table and number in the fence file, and its name")]
    keep_in: Annotated[bool, Meta(description="the vehicle has to stay inside; false: outside")]
    vertices_m: Annotated[PositionRows, Meta(description="(K, 2) north, east of the vertices; of a disc: its centre")]
    radius_m: Annotated[Length, Meta(description="radius of a disc; 0 for a polygon")]
    margin_m: Annotated[Length, Meta(description="distance between boundary and hull that is kept free")]


class FenceInForce(Message, frozen=True, kw_only=True, eq=False):
    """Fence that the controller keeps, and the obstacles that it knows. Without zones there is no fence."""

    t_ns: PublicationTime
    hull_radius_m: Annotated[Length, Meta(description="radius of the circle around the hull")]
    zones: Annotated[tuple[ZoneInForce, ...], Meta(max_length=300, description="zones of the fence")] = ()
    obstacles: Annotated[tuple[Obstacle, ...], Meta(max_length=64, description="obstacles not dropped yet")] = ()


class CycleTiming(Message, frozen=True, kw_only=True, eq=False):
    """Computing time of one controller cycle, measured by its caller.

    It is zero in lock step, where the delay is a setting. ``stage_us`` is wall time by step: read, predict, linearise,
    build, update, solve, publish. ``compute_ns`` is vehicle time from the start of the cycle to the publication
    of its plan, ``compute_wall_ns`` the same in wall time.
    """

    t_ns: Annotated[Time, Meta(description="start of the cycle")]
    compute_ns: Annotated[Duration, Meta(description="from the start of the cycle to publication, vehicle time")]
    compute_wall_ns: Annotated[Duration, Meta(description="from the start of the cycle to publication, wall time")]
    estimate_age_ns: Annotated[Time, Meta(description="age of the estimate at the start of the cycle")]
    stage_us: Annotated[dict[str, WallTime], Meta(description="wall time by step of the cycle")]


class ModelCheck(Message, frozen=True, kw_only=True, eq=False):
    """Consistency of the vehicle with its model: observed minus predicted motion between two estimates."""

    t_ns: PublicationTime
    residual_N: Annotated[Force, Meta(description="surge force, observed minus predicted, mean since the last message")]
    residual_Nm: Annotated[
        Moment, Meta(description="yaw moment, observed minus predicted, mean since the last message")
    ]
    evidence: Annotated[
        Dimensionless, Meta(description="log-likelihood ratio of a thrust loss that model mismatch does not explain")
    ]
    thrust_loss: Annotated[
        tuple[Share, Share], Meta(description="most likely lost share of the thrust: port, starboard")
    ]
    alarm: Annotated[bool, Meta(description="the vehicle does not move as its model predicts")]
    why: Annotated[str, Meta(description="reason of the alarm")]


class InputReport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """State of one input of the controller."""

    input: Annotated[str, Meta(description="key of the input")]
    alive: Annotated[bool, Meta(description="a message arrived recently")]
    valid: Annotated[bool, Meta(description="the stamp of the newest message is current")]
    rate: Annotated[bool, Meta(description="at most half of the recent messages are missing")]
    age_ns: Annotated[Time | None, Meta(description="age of the newest message; null before the first")]
    period_ns: Annotated[Duration, Meta(description="median spacing of the stamps; 0 before the second")]
    rejected: Annotated[Count, Meta(description="messages rejected so far: out of order or implausible")]


class ClockStep(Message, frozen=True, kw_only=True, eq=False):
    """Step of the clock of a publisher, as the controller recognised it. Its vehicle time runs on without a step."""

    t_ns: Annotated[Time, Meta(description="time of the recognition")]
    input: Annotated[str, Meta(description="key of the message that showed it")]
    publisher: Annotated[Identifier, Meta(description="epoch of the publisher")]
    step_ns: Annotated[Time, Meta(description="change of its clock, positive if it was set forward")]
    certain: Annotated[
        bool,
        Meta(description="false: seen by constant lateness alone, which a congested link can cause: degraded for 10 s"),
    ]


class ClockMode(enum.StrEnum):
    """Source of vehicle time in a process."""

    SHARED = "shared"  # the ``clock`` topic, or the own clock if no stamps of others are compared with it
    TWO_WAY = "two-way"  # the clock of the other side, by a two-way exchange
    ONE_WAY = "one-way"  # the clock of the other side, by its stamps alone: behind by an unknown delay


class ControllerStatus(Message, frozen=True, kw_only=True, eq=False):
    """Status of the controller: inputs, cycle times, authority. Times are those of the last 10 s."""

    t_ns: PublicationTime
    estimate_age_ns: Annotated[Time | None, Meta(description="age of the newest estimate; null before the first")]
    applied_age_ns: Annotated[
        Time | None,
        Meta(description="age of the newest applied message; null before the first: plans are assumed to be followed"),
    ]
    cycle_median_us: Annotated[
        WallTime | None, Meta(description="from the start of a cycle to its plan, median of 10 s; null: no cycle")
    ]
    cycle_p99_us: Annotated[WallTime | None, Meta(description="99th percentile of the same")]
    received: Annotated[Count, Meta(description="messages accepted so far")]
    dropped: Annotated[Count, Meta(description="messages lost so far, by gaps in the sequences")]
    rejected: Annotated[dict[str, Count], Meta(description="messages rejected so far, by reason")]
    clock: Annotated[ClockMode, Meta(description="source of vehicle time in the controller")]
    clock_error_ns: Annotated[
        Duration | None, Meta(description="bound of the clock error; null: one-way, where it is unknown")
    ]
    clock_steps: Annotated[Count, Meta(description="steps of the publishers' clocks so far")] = 0
    checkpoints_failed: Annotated[Count, Meta(description="checkpoints that could not be written so far")] = 0
    authority: Annotated[Authority, Meta(description="source of the thrust commands")]
    health: Annotated[Health, Meta(description="timeliness of the inputs of the controller")]
    health_why: HealthReason = ""
    mission_action: Annotated[MissionAction, Meta(description="action of the mission policy")] = MissionAction.GO_ON
    error_m: Annotated[
        Position | None,
        Meta(description="horizontal distance of the newest estimate from the reference; null: no reference in force"),
    ]
    progress: ReferenceProgress = None
    arrived: Arrived = False
    inputs: Annotated[tuple[InputReport, ...], Meta(description="inputs whose age is monitored")] = ()
    source: Annotated[
        SourceChoice, Meta(description="name of the source of the estimates in use; empty before the first")
    ] = ""
    source_epoch: Annotated[Identifier, Meta(description="epoch of that source; 0 before the first")] = 0
    rejected_epoch: Annotated[
        Identifier, Meta(description="epoch of a second source that publishes on its key and is rejected; 0: none")
    ] = 0
    rejected_estimates: Annotated[Count, Meta(description="estimates of second sources rejected so far")] = 0


class ReferenceStart(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Time, position and motion of the vehicle at the start of a reference."""

    t_ns: Annotated[Time, Meta(description="time at which the reference started")]
    north_m: North
    east_m: East
    depth_m: Annotated[Depth, Meta(description="depth below the surface")]
    heading_rad: Annotated[Angle, Meta(description="true heading, clockwise from north seen from above")]
    velocity_mps: Annotated[tuple[Speed, Speed], Meta(description="over ground: north, east")]


class DisturbanceState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Belief of the disturbance observer, 12 states in the order of ``control/disturbance_filter.py``."""

    mean: Annotated[
        FilterStates,
        Meta(
            description="current's bias north, east (m/s); lever arm forward, starboard (m); logarithms of the factors "
            "of mass ahead, abeam, inertia, drag ahead, abeam, in yaw; added Munk mass over mass; yaw moment over "
            "inertia (rad/s2)"
        ),
    ]
    covariance: Annotated[CovarianceMatrix, Meta(description="12 x 12, of these states")]


class MissionState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """State of the mission policy: start of the mission, last sign of the operator, and the action in force."""

    start_t_ns: Annotated[Time | None, Meta(description="start of the mission time; null: not armed yet")] = None
    operator_t_ns: Annotated[Time | None, Meta(description="last sign of an operator; null: none yet")] = None
    action: Annotated[MissionAction, Meta(description="action in force")] = MissionAction.GO_ON
    why: Annotated[str, Meta(description="cause of the action; empty if it is to go on")] = ""
    skipped: Annotated[
        tuple[str, ...], Meta(description="names of causes without effect: a forced `arm` skipped them")
    ] = ()


class ControllerState(Message, frozen=True, kw_only=True, eq=False):
    """State of a controller between two cycles: authority, reference, last plan, and what it has learned.

    The controller publishes it every 5 s and at each change of authority or reference. A controller that replaces a
    dead one receives the newest state as its first message. It comes from the supervisor, which has replaced ``plan``
    by the plan that is in force at that time, or from the checkpoint of --state.
    """

    t_ns: PublicationTime
    authority: Annotated[Authority, Meta(description="source of the thrust commands")] = Authority.DISARMED
    reference_toml: Annotated[
        ReferenceText,
        Meta(description="current reference, in the format of a reference file; empty: the reference of the start"),
    ] = ""
    reference_start: Annotated[
        ReferenceStart | None, Meta(description="start of the reference; null before it is in force")
    ] = None
    fence_toml: Annotated[ReferenceText, Meta(description="fence in force, as a fence file holds it; empty: none")] = ""
    arm_continues: Annotated[
        bool, Meta(description="the next arm continues the reference: a restart, and no operator, has disarmed")
    ] = False
    schedule_t_ns: Annotated[
        Time, Meta(description="time at which schedule_s was valid: first knot of the last plan")
    ] = 0
    schedule_s: Annotated[ScheduleTime, Meta(description="time of the target on the schedule of the reference")] = 0.0
    schedule_rate: Annotated[
        Share, Meta(description="rate of schedule time to vehicle time; below 1 the target waits")
    ] = 1.0
    progress: ReferenceProgress = None
    arrived: Arrived = False
    depth_integral_N: Annotated[
        Force, Meta(description="integral of the depth law: the vertical thrust that holds a depth")
    ] = 0.0
    plan_delays_ns: Annotated[
        Durations, Meta(description="of the last plans: from the start of the cycle to arrival at the actuators")
    ] = ()
    cycle_times_ns: Annotated[Durations, Meta(description="of the last cycles: computing time alone")] = ()
    disturbance: Annotated[
        DisturbanceState | None, Meta(description="what the controller has learned of water and vehicle; null: nothing")
    ] = None
    model_products: Annotated[
        ModelProductMatrix | None,
        Meta(description="6 x 6 sums of products of missing impulse and of its five regressors"),
    ] = None
    thrust_shares: Annotated[
        tuple[ThrustShare, ThrustShare],
        Meta(description="share of the reported thrust that port and starboard deliver; below 1: a weak thruster"),
    ] = (1.0, 1.0)
    plan: Annotated[
        Plan | None, Meta(description="last plan sent; after a restart, the plan in force at the actuators")
    ] = None
    estimate: Annotated[Estimate | None, Meta(description="newest estimate, of the vehicle's origin")] = None
    source: Annotated[SourceChoice, Meta(description="name of the source that an operator has chosen; else empty")] = ""
    mission: Annotated[MissionState, Meta(description="state of the mission policy")] = MissionState()


# --- written by the actuators ----------------------------------------------------------------------------------------


class Applied(Message, frozen=True, kw_only=True, eq=False):
    """Report of the actuators to the controller: the thrusts they deliver and the plan they follow."""

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
        Count,
        Meta(description="plans rejected so far: outside box or slew limit, out of order, or of a second controller"),
    ]
    health: Annotated[
        Health,
        Meta(
            description="timeliness of the plans: degraded if two are missing, failsafe after the end of the last one"
        ),
    ] = Health.NOMINAL
    why: Annotated[
        str,
        Meta(
            max_length=200, description="why the plans are not followed, such as a released autopilot; empty: they are"
        ),
    ] = ""


# --- written by the vehicle's monitors of battery and leaks -----------------------------------------------------------


class Battery(Message, frozen=True, kw_only=True, eq=False):
    """State of the battery. It has no time: the controller uses the time of arrival."""

    voltage_V: Annotated[Voltage, Meta(description="voltage under the present load")]
    remaining: Annotated[Share | None, Meta(description="remaining share of the energy; null: unknown")] = None


class Leak(Message, frozen=True, kw_only=True, eq=False):
    """State of the leak detectors. It has no time: the controller uses the time of arrival."""

    detected: Annotated[bool, Meta(description="water in the hull")]


# --- written by the operator: commands to the controller, disturbances and faults for a simulation --------------------


class Action(enum.StrEnum):
    """Command of an operator to the controller."""

    ARM = "arm"  # the controller takes the thrusters; its reference starts again
    DISARM = "disarm"  # thrusts to zero until armed
    STOP = "stop"  # thrusts to zero in every state, until armed
    MANUAL = "manual"  # the pilot takes the thrusters: they follow the ``manual`` messages
    RELEASE = "release"  # the pilot returns the thrusters to the controller
    FOLLOW = "follow"  # another reference
    HOLD = "hold"  # hold the current position
    SOURCE = "source"  # use the estimates of one source
    FENCE = "fence"  # another fence, or none
    CLEAR = "clear"  # end the action of the mission policy, if its cause is gone


class Command(Message, frozen=True, kw_only=True, eq=False):
    """Command of an operator. The controller replies with an ``Acknowledgement`` of the same ``command_id``."""

    command_id: Annotated[
        Identifier, Meta(description="chosen by the sender, repeated in the reply; 48 random bits are unique")
    ]
    action: Annotated[Action, Meta(description="requested action")]
    reference_toml: Annotated[ReferenceText, Meta(description="for follow: contents of a reference file, TOML")] = ""
    fence_toml: Annotated[
        ReferenceText, Meta(description="for fence: contents of a fence file, TOML; empty: no fence from now on")
    ] = ""
    force: Annotated[bool, Meta(description="for arm: arm although pre-arm checks fail")] = False
    source: Annotated[
        SourceChoice,
        Meta(description="for source: its name, `default` for the plain key; empty: the order of the settings"),
    ] = ""


class Obstacles(Message, frozen=True, kw_only=True, eq=False):
    """Reports of obstacles, of any source (AIS, sonar). An obstacle that is not reported again is dropped when old."""

    t_ns: PublicationTime
    obstacles: Annotated[tuple[Obstacle, ...], Meta(max_length=64, description="some or all obstacles")]


class Heartbeat(Message, frozen=True, kw_only=True, eq=False):
    """Sign of life of an operator. Commands and messages of a pilot count as one too."""


class Manual(Message, frozen=True, kw_only=True, eq=False):
    """Thrusts that a pilot requests. They are valid for 1 s after arrival, then the thrusts return to zero."""

    thrust_N: Annotated[Forces, Meta(description="requested: port, starboard, vertical; valid for 1 s after arrival")]


class ClockCommand(Message, frozen=True, kw_only=True, eq=False):
    """Command to pause vehicle time or change its speed. The simulated vehicle, which keeps the time, reads it."""

    paused: Annotated[bool, Meta(description="vehicle time stands still")]
    speed: Annotated[SpeedOfTime, Meta(description="vehicle seconds per wall second")]


class Disturbance(Message, frozen=True, kw_only=True, eq=False):
    """External force, moment and thrust loss that act on the simulated vehicle.

    It acts from its arrival until ``end_t_ns`` and replaces the one before it. No process aboard the vehicle reads it.
    """

    end_t_ns: Annotated[Time, Meta(description="vehicle time at which it ends")]
    thrust_scale: Annotated[
        Shares, Meta(description="ratio of delivered thrust to that of the propellers: port, starboard, vertical")
    ] = (1.0, 1.0, 1.0)
    force_N: Annotated[Forces, Meta(description="on the vehicle: north, east, down")] = (0.0, 0.0, 0.0)
    yaw_moment_Nm: Annotated[Moment, Meta(description="about down, positive to starboard")] = 0.0


class Kill(Message, frozen=True, kw_only=True, eq=False):
    """Command to the supervisor of a simulation to kill one process, to test the reaction of the others."""

    node: Annotated[str, Meta(description="node whose process is killed")]


# --- written by every process: status, events, rejected frames, a record of each step --------------------------------


class NodeStatus(Message, frozen=True, kw_only=True, eq=False):
    """Status of one process: readiness, counters, and what it waits for."""

    node: Publisher
    t_ns: PublicationTime
    ready: Annotated[bool, Meta(description="the node can do its work")]
    waiting_for: Annotated[str, Meta(description="what the node waits for; empty if nothing")]
    steps: Annotated[Count, Meta(description="steps so far")]
    published: Annotated[Count, Meta(description="messages published so far, on all keys")]
    received: Annotated[Count, Meta(description="messages accepted so far")]
    dropped: Annotated[Count, Meta(description="messages lost so far, by gaps in the sequences")]
    rejected: Annotated[Count, Meta(description="messages rejected so far")]
    step_us: Annotated[WallTime, Meta(description="mean wall time of a step since the last status")]
    min_queue_delay_us: Annotated[
        WholeWallTime,
        Meta(description="smallest wall time that a message waited since the last status; above 0: a standing queue"),
    ] = 0
    finished: Annotated[bool, Meta(description="the node has done all its work; this is its last status")] = False


class NodeSettings(Message, frozen=True, kw_only=True, eq=False):
    """Settings of a process that runs aboard: a replay builds its node again from them.

    The process publishes them at its start, at its first step and every 10 s: a recorder may start before or after it.
    """

    node: Publisher
    files: Annotated[dict[str, str], Meta(description="settings files by path, such as config/vehicle.toml")]
    made_by: Annotated[dict[str, str], Meta(description="versions, commit and processor")]


class RunEvent(Message, frozen=True, kw_only=True, eq=False):
    """Event to be marked on the time axis: a phase, a loss, a restart."""

    t_ns: Annotated[Time, Meta(description="time of the event")]
    node: Publisher
    kind: Annotated[str, Meta(description="kind of the event, one word")]
    text: Annotated[str, Meta(description="description of the event")]


class RejectedFrame(Message, frozen=True, kw_only=True, eq=False):
    """Frame that the message validation of a node rejected."""

    t_ns: Annotated[Time, Meta(description="time of arrival")]
    node: Publisher
    key: Key
    reason: Annotated[str, Meta(description="reason of the rejection, with the field and its bound")]
    crc: Crc
    payload_base64: Annotated[str, Meta(description="first bytes of the frame, at most 3072")]


class InboxEntry(msgspec.Struct, frozen=True, array_like=False, kw_only=True, forbid_unknown_fields=True):
    """Reference to one message in the inbox of a step, sufficient to find its frame in the recording."""

    key: Key
    epoch: Annotated[Identifier, Meta(description="epoch in the header of the message")]
    sequence: Annotated[Count, Meta(description="sequence in the header of the message")]
    crc: Crc
    received_t_ns: Annotated[Time, Meta(description="time of arrival")]
    shift_ns: Annotated[
        Time, Meta(description="vehicle time minus the time of its publisher, added to the times in the message")
    ] = 0


class RecordedStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One step of a node: all that it received."""

    t_ns: Annotated[Time, Meta(description="time of the step")]
    cause: Annotated[str, Meta(description="grid, cycle, or the key of the message that caused the step")]
    inbox: Annotated[tuple[InboxEntry, ...], Meta(description="messages that the step received, in order")]
    shift_ns: Annotated[
        Time, Meta(description="time of the actuators minus vehicle time, added to the times in the outputs")
    ] = 0


class StepRecord(Message, frozen=True, kw_only=True, eq=False):
    """Record of consecutive steps of a node, published before their outputs. An exact replay needs it."""

    node: Publisher
    epoch: Annotated[Identifier, Meta(description="epoch of the node, as in its headers")]
    step: Annotated[Count, Meta(description="number of the first step; the node's first one has number 0")]
    steps: Annotated[tuple[RecordedStep, ...], Meta(description="the steps, in order")]


# --- written by the clock master -------------------------------------------------------------------------------------


class ClockState(enum.StrEnum):
    """State of vehicle time."""

    WAITING = "waiting"
    RUNNING = "running"
    PAUSED = "paused"


class Clock(Message, frozen=True, kw_only=True, eq=False):
    """Relation of vehicle time to monotonic time.

    While running, vehicle time = vehicle_ns + (monotonic - at_monotonic) x speed_num / speed_den. Monotonic times are
    CLOCK_MONOTONIC of the host in microseconds: below 2^53 for 285 years, so every language reads them exactly.
    """

    clock_epoch: Annotated[Identifier, Meta(description="identifies one start of the clock master")]
    clock_sequence: Annotated[Count, Meta(description="number of the announcement; a repetition keeps its number")]
    host_boot_id: Annotated[
        str, Meta(description="boot of the host of the clock master; monotonic times are comparable within one boot")
    ]
    at_monotonic_us: Annotated[MonotonicTime, Meta(description="CLOCK_MONOTONIC from which this relation holds")]
    vehicle_ns: Annotated[Time, Meta(description="vehicle time at that instant")]
    speed_num: Annotated[PositiveInteger, Meta(description="speed in force, numerator")]
    speed_den: Annotated[PositiveInteger, Meta(description="speed in force, denominator")]
    requested_speed: Annotated[
        SpeedOfTime, Meta(description="requested vehicle seconds per wall second; the speed in force may be lower")
    ]
    state: Annotated[ClockState, Meta(description="state of vehicle time from then on")]
