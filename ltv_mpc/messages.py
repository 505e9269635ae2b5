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
number carries the bounds of its quantity (``ge``, ``le``) and its unit; the docstring below a field is its meaning,
also in the schemas and pages. An array is annotated with the list that represents it on the wire: ``Meta(extra={"wire":
list[list[Force]]})`` is a matrix of forces. ``None`` in such a list is a missing value, which is NaN in the array.
"""

from __future__ import annotations

import enum
from pathlib import Path
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

    t_ns: Time
    """time of validity"""
    position_m: Positions
    """north, east, down"""
    velocity_mps: Speeds
    """over ground: north, east, down"""
    attitude_rad: Angles
    """roll, pitch, heading"""
    water_velocity_mps: Speeds
    """velocity through the water: surge, sway, heave, in the level heading frame"""
    yaw_rate_radps: AngularRate
    """rate of turn about the down axis, positive to starboard"""
    current_mps: tuple[WaterSpeed, WaterSpeed]
    """velocity of the water at the vehicle over ground: north, east"""
    thrust_N: Forces
    """delivered: port, starboard, vertical"""


# --- written by the sensors, read by the estimator -------------------------------------------------------------------


class ImuSample(Message, frozen=True, kw_only=True, eq=False):
    """Mean angular rate and specific force of a strapdown IMU, in the body frame.

    Each is the increment over the interval that ends at ``t_ns``, divided by the length of that interval.
    """

    t_ns: Time
    """end of the interval"""
    interval_ns: Interval
    """length of the interval"""
    angular_rate_radps: AngularRates
    """mean over the interval: forward, starboard, down"""
    specific_force_mps2: SpecificForces
    """mean over the interval: forward, starboard, down"""


class ImuSamples(Message, frozen=True, kw_only=True, eq=False):
    """Samples of a strapdown IMU since the last message; a driver that has one at a time publishes one."""

    samples: Annotated[tuple[ImuSample, ...], Meta(min_length=1, max_length=1000)]
    """in order of time, each with its own"""

    @property
    def t_ns(self) -> int:
        """Time of the newest sample (ns)."""
        return self.samples[-1].t_ns


class GnssFix(Message, frozen=True, kw_only=True, eq=False):
    """Position and velocity over ground from satellite navigation, at the surface."""

    t_ns: Time
    """time of validity"""
    north_m: Position
    """position north of the origin"""
    east_m: Position
    """position east of the origin"""
    velocity_north_mps: Speed
    """velocity over ground, north"""
    velocity_east_mps: Speed
    """velocity over ground, east"""


class TdcpFix(Message, frozen=True, kw_only=True, eq=False):
    """Change of position between two epochs from time-differenced carrier phase, at the surface."""

    t_ns: Time
    """time of validity"""
    from_t_ns: Time
    """the earlier epoch"""
    north_m: Position
    """change of position from the earlier epoch to t_ns, north"""
    east_m: Position
    """change of position from the earlier epoch to t_ns, east"""


class AdcpPing(Message, frozen=True, kw_only=True, eq=False):
    """Velocity of the water relative to the transducer along each beam, positive away from the vehicle.

    ``range_m`` (K,) is the slant range to the centre of each cell. ``beam_velocity_mps`` is (4, K); it is NaN (null on
    the wire) where a beam has no return.
    """

    t_ns: Time
    """time of validity"""
    range_m: SlantRanges
    """slant range to the centre of each cell, increasing"""
    beam_velocity_mps: BeamSpeedRows
    """4 x K, of the water along each beam, positive away from the vehicle; null: no return"""


class PressureDepth(Message, frozen=True, kw_only=True, eq=False):
    """Depth below the surface from pressure."""

    t_ns: Time
    """time of validity"""
    depth_m: Depth
    """depth below the surface"""


class CompassHeading(Message, frozen=True, kw_only=True, eq=False):
    """True heading from a magnetic compass, corrected for deviation and declination, in (-pi, pi]."""

    t_ns: Time
    """time of validity"""
    heading_rad: Angle
    """true heading, corrected for deviation and declination"""


class BottomTrack(Message, frozen=True, kw_only=True, eq=False):
    """Velocity of the sea bed relative to the transducer along each beam, positive away from the vehicle.

    ``range_m`` (4,) is the slant range to the bottom. Both fields are NaN (null on the wire) for a beam without a
    bottom return.
    """

    t_ns: Time
    """time of validity"""
    range_m: SlantRangesOrNone
    """slant range to the bottom by beam; null: no return"""
    beam_velocity_mps: BeamSpeeds
    """of the bottom along each beam, positive away from the vehicle; null: no return"""


class LblRange(Message, frozen=True, kw_only=True, eq=False):
    """Two-way travel time to a transponder of a long baseline.

    Half of it is the range, valid at the middle between interrogation and reply.
    """

    t_ns: Time
    """middle between interrogation and reply"""
    transponder: Index
    """index in the sensors file, from 0"""
    travel_time_s: TravelTime
    """two-way travel time, without the turn-around time of the transponder"""


class UsblFix(Message, frozen=True, kw_only=True, eq=False):
    """Position over ground that a ship measured acoustically and sent down. It arrives after its time of validity."""

    t_ns: Time
    """time of validity"""
    north_m: Position
    """position north of the origin"""
    east_m: Position
    """position east of the origin"""


# --- written by the estimator: the estimate for the controller, a report for people, its state for a restart ---------


class CurrentProfile(Message, frozen=True, kw_only=True, eq=False):
    """Horizontal water velocity over depth: linear between the depths, constant beyond both ends. Arrays are (K,)."""

    depth_m: Depths
    """K depths, increasing; linear between them, constant beyond both ends"""
    north_mps: WaterSpeeds
    """velocity of the water over ground at each depth, north"""
    east_mps: WaterSpeeds
    """velocity of the water over ground at each depth, east"""
    sd_mps: SpeedDeviations | None = None
    """standard deviation of either component at each depth"""

    @classmethod
    def load(cls, path: str | Path) -> CurrentProfile:
        """Read a profile from a CSV file. Raises ``ConfigError``.

        Parameters
        ----------
        path : of the file, which ``ltv_mpc/currents.py`` describes.
        """
        from ltv_mpc.currents import read_profile

        return read_profile(path)


class Estimate(Message, frozen=True, kw_only=True, eq=False):
    """Estimated position and motion of the vehicle over ground, at the reference point that its file declares.

    ``covariance`` is (6, 6) over north, east (m), velocity north, east (m/s), heading (rad), yaw rate (rad/s).
    """

    t_ns: Time
    """time of validity"""
    north_m: Position
    """position north of the origin"""
    east_m: Position
    """position east of the origin"""
    heading_rad: Angle
    """true heading, clockwise from north; may be unwrapped"""
    yaw_rate_radps: AngularRate
    """rate of turn about the down axis, positive to starboard"""
    velocity_north_mps: Speed
    """velocity over ground, north"""
    velocity_east_mps: Speed
    """velocity over ground, east"""
    depth_m: Depth | None = None
    """depth below the surface; omitted by surface craft"""
    velocity_down_mps: Speed | None = None
    """sinking speed; 0 is assumed if omitted"""
    altitude_m: SlantRange | None = None
    """height above the bottom; omitted if it is not seen"""
    covariance: CovarianceMatrix | None = None
    """6 x 6 of north, east, velocity north, velocity east, heading, yaw rate"""
    current: CurrentProfile | None = None
    """velocity of the water over depth, as far as it is known"""

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

    sensor: str
    """name in the sensors file"""
    status: SensorStatus
    """consistency of the sensor with the filter"""
    used: Count
    """scalar measurements that corrected the filter since the last report"""
    rejected: dict[str, Count]
    """measurements rejected since the last report, by reason: gate, late, no_return, ..."""
    nis: Dimensionless | None
    """mean normalised innovation squared per degree of freedom, before the gate"""
    last_t_ns: Time | None
    """time of validity of the newest message; null: none yet"""


class InnovationSample(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Innovations of one message of a sensor that passed the gate: measurement minus its prediction by the filter."""

    sensor: str
    """name in the sensors file"""
    t_ns: Time
    """time of validity"""
    rows: tuple[Index, ...]
    """index of each measurement in its message; gnss: 0, 1 position, 2, 3 velocity; lbl: transponder"""
    innovations: tuple[Innovation, ...]
    """in the unit of the measurement"""
    sd: tuple[InnovationDeviation, ...]
    """standard deviation that the filter expects"""


class LocalisationReport(Message, frozen=True, kw_only=True, eq=False):
    """Health report of the localisation filter and its sensors."""

    t_ns: Time
    """time of validity"""
    status: FilterStatus
    """consistency of the filter"""
    why: str
    """reason of the status; empty while nominal"""
    restarts: Count
    """restarts of the filter so far"""
    water_walk_mps_per_rts: RandomWalk
    """random walk added to that of the current because the innovations require it; 0: none"""
    sensors: tuple[SensorReport, ...]
    """one report for each sensor"""
    innovations: tuple[InnovationSample, ...] = ()
    """at most four innovations of the newest message of each sensor since the last report"""


class DroppedGridPoint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Conditional distribution of the current at a depth that left the state vector of the filter.

    ``localisation/water/column.py`` has its equation.
    """

    grid_point: Index
    """index in the depth grid, from 0 at the surface"""
    velocity_mps: tuple[Speed, Speed]
    """velocity of the water over ground: north, east"""
    conditioning_states: FilterStates
    """q states at that time, on which the velocity is conditioned"""
    regression: FilterStateRows
    """2 x q, regression of the velocity on those states"""
    covariance: CovarianceMatrix
    """2 x 2, covariance of the velocity given those states"""
    position_cross_covariance: CovarianceMatrix
    """2 x 2, covariance of the velocity with the position"""
    position_covariance: CovarianceMatrix
    """2 x 2, covariance of the position given those states, at that time"""
    walk_variance_m2ps2: SpeedVariance
    """variance gained through the random walk up to that time"""


class EstimatorState(Message, frozen=True, kw_only=True, eq=False):
    """State of the localisation filter, n states in the order of ``localisation/filter/state.py``.

    The state vector depends on the settings of sensors and filter, so a state is valid only with the settings whose
    CRC-32 is ``settings_crc``. The estimator publishes its state every 5 s. An estimator that replaces a dead one
    receives the newest state as its first message.
    """

    t_ns: Time
    """time of validity"""
    settings_crc: Identifier
    """CRC-32 of the settings of sensors and filter; the state is valid only with them"""
    x: FilterStates
    """n states, in the order of the filter"""
    attitude: RotationMatrix
    """3 x 3, body to north, east, down"""
    mounting: RotationMatrix
    """3 x 3, profiler to body"""
    covariance: Covariances
    """of the states: lower triangle, row by row, n (n + 1) / 2 numbers"""
    epoch_t_ns: Time
    """satellite epoch whose position is among the states"""
    first_grid_point: Index
    """first point of the depth grid whose current is among the states"""
    measured_grid_points: Indices
    """points of the depth grid at which the profiler has measured"""
    dropped_grid_points: tuple[DroppedGridPoint, ...]
    """conditional distributions of grid points that left the states"""
    walk_variance_m2ps2: SpeedVariance
    """variance that each grid point has gained through the random walk"""
    restarts: Count
    """restarts of the filter so far"""
    estimate: Estimate | None = None
    """newest published estimate, which the supervisor adds for a restart"""


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

    id: Identifier
    """a later report with this id replaces this one"""
    t_ns: Time
    """time of validity"""
    north_m: Position
    """position north of the origin"""
    east_m: Position
    """position east of the origin"""
    velocity_north_mps: Speed
    """velocity over ground, north"""
    velocity_east_mps: Speed
    """velocity over ground, east"""
    radius_m: Length
    """of a circle around it"""
    covariance_m2: tuple[Covariance, Covariance, Covariance] = (0.0, 0.0, 0.0)
    """of its position: north-north, north-east, east-east"""


class Solve(Message, frozen=True, kw_only=True, eq=False):
    """Result of one solve; residuals are those of the scaled problem."""

    status: SolveStatus
    """outcome of the solve"""
    iterations: Count = 0
    """iterations of the solver"""
    primal_residual: Residual = 0.0
    """primal residual of the scaled problem"""
    dual_residual: Residual = 0.0
    """dual residual of the scaled problem"""
    why: str = ""
    """reason of a failure; empty if there is none"""


class FenceReport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Zones of the fence and obstacles beside a plan. Distances are between the hull and the boundary."""

    clearance_m: Position | None
    """least distance from a zone or obstacle over the plan; negative: inside"""
    nearest: str = ""
    """label of that zone or obstacle; empty if there is none"""
    active: tuple[str, ...] = ()
    """zones and obstacles that bound the plan"""
    in_margin: tuple[str, ...] = ()
    """those whose margin the hull is in at the first knot"""
    inside: tuple[str, ...] = ()
    """those that the hull is in at the first knot"""
    exceeded: Count = 0
    """knots that lack more than 1 cm of a required clearance, of all zones and obstacles"""
    skipped_m: Length = 0.0
    """length of the path that is left out: zones and margins"""
    no_way: bool = False
    """no way round the zones leads to the target"""
    time_to_zone_ns: Duration | None = None
    """from the first knot until the hull is in a zone or obstacle; null: not within the plan, nor within 10 minutes of
    drift after a plan that is not solved
    """
    dropped: tuple[Identifier, ...] = ()
    """obstacles of which a report was dropped in this cycle: too old, or ahead of vehicle time"""


class Plan(Message, frozen=True, kw_only=True, eq=False):
    """Future thrusts, piecewise linear between knots. Without another plan the actuators follow it for a while.

    ``t_ns`` (N+1,) are the knots; the plan takes effect at the first. ``thrust_N`` (N+1, 3) are the commands at the
    knots. ``states`` (N+1, 6) are the predicted n, e (m), u, v (m/s, through the water), heading (rad), yaw rate
    (rad/s). States and target are those of the vehicle's reference point, as the estimates are.
    """

    cycle_t_ns: Time
    """start of the cycle that computed the plan"""
    t_ns: Knots
    """N + 1 knots, increasing; the plan takes effect at the first"""
    thrust_N: ForceRows
    """(N + 1) x 3, commands at the knots: port, starboard, vertical"""
    states: VehicleStateRows
    """(N + 1) x 6, predicted: north, east, surge, sway (through the water), heading, yaw rate"""
    origin: PlanOrigin
    """origin of the thrusts, best first"""
    solve: Solve
    """result of the solve"""
    why: str = ""
    """reason of the origin, if it is not solved; else what is missing"""
    authority: Authority = Authority.CONTROLLER
    """source of the thrust commands"""
    health: Health = Health.NOMINAL
    """timeliness of the inputs of the controller"""
    health_why: str = ""
    """reason of the health; empty if it is nominal"""
    estimate_t_ns: Time = 0
    """t_ns of the estimate on which the plan is based"""
    expected_delay_ns: Duration = 0
    """from the start of the cycle to the first knot"""
    reference_m: tuple[Position, Position] | None = None
    """north, east of the target at the first knot; null before the reference starts"""
    reference_depth_m: Depth | None = None
    """depth at which the reference ends; null if it has no depth"""
    reference_heading_rad: Angle | None = None
    """heading wanted at a point; null: it is free"""
    depth_limit_m: Depth | None = None
    """depth limit that keeps the vehicle from the depth of the reference; null: none"""
    progress: Share | None = None
    """share of the path that the target has completed"""
    cross_track_m: Position | None = None
    """distance from the path at the first knot, positive to starboard"""
    remaining_m: Length | None = None
    """length of the path ahead of the target"""
    arrived: bool = False
    """the vehicle has come to the end of the reference, and not its target alone"""
    delivered_N: tuple[Force, Force, Force] | None = None
    """predicted thrust of port, starboard and vertical at the first knot; null: unknown"""
    fence: FenceReport | None = None
    """zones and obstacles beside the plan; null: no fence and no obstacle"""

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
        i = min(max(int(self.t_ns.searchsorted(t_ns, side="right")), 1), len(self.t_ns) - 1)
        t0, t1 = self.t_ns[i - 1 : i + 1].tolist()
        before, after = self.thrust_N[i - 1 : i + 1]
        thrust: Array = before + min(max((t_ns - t0) / (t1 - t0), 0.0), 1.0) * (after - before)
        return thrust


class Acknowledgement(Message, frozen=True, kw_only=True, eq=False):
    """Reply of the controller to a ``Command``."""

    t_ns: Time
    """time of the decision"""
    command_id: Identifier
    """command_id of the command"""
    accepted: bool
    """the command was carried out"""
    authority: Authority
    """source of the thrust commands after it"""
    why: str
    """reason of the rejection; empty if the command was accepted"""
    warnings: tuple[str, ...] = ()
    """of an accepted command: what it skipped, could not check or does not end"""


class ZoneInForce(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Zone of the fence in force, in the local frame."""

    label: Annotated[str, Meta(max_length=200)]
    """table and number in the fence file, and its name"""
    keep_in: bool
    """the vehicle has to stay inside; false: outside"""
    vertices_m: PositionRows
    """(K, 2) north, east of the vertices; of a disc: its centre"""
    radius_m: Length
    """radius of a disc; 0 for a polygon"""
    margin_m: Length
    """distance between boundary and hull that is kept free"""


class FenceInForce(Message, frozen=True, kw_only=True, eq=False):
    """Fence that the controller keeps, and the obstacles that it knows. Without zones there is no fence."""

    t_ns: Time
    """time of publication"""
    hull_radius_m: Length
    """radius of the circle around the hull"""
    zones: Annotated[tuple[ZoneInForce, ...], Meta(max_length=300)] = ()
    """zones of the fence"""
    obstacles: Annotated[tuple[Obstacle, ...], Meta(max_length=64)] = ()
    """obstacles not dropped yet"""


class CycleTiming(Message, frozen=True, kw_only=True, eq=False):
    """Computing time of one controller cycle, measured by its caller.

    It is zero in lock step, where the delay is a setting. ``stage_us`` is wall time by step: read, predict, linearise,
    build, update, solve, publish. ``compute_ns`` is vehicle time from the start of the cycle to the publication
    of its plan, ``compute_wall_ns`` the same in wall time.
    """

    t_ns: Time
    """start of the cycle"""
    compute_ns: Duration
    """from the start of the cycle to publication, vehicle time"""
    compute_wall_ns: Duration
    """from the start of the cycle to publication, wall time"""
    estimate_age_ns: Time
    """age of the estimate at the start of the cycle"""
    stage_us: dict[str, WallTime]
    """wall time by step of the cycle"""


class ModelCheck(Message, frozen=True, kw_only=True, eq=False):
    """Consistency of the vehicle with its model: observed minus predicted motion between two estimates."""

    t_ns: Time
    """time of publication"""
    residual_N: Force
    """surge force, observed minus predicted, mean since the last message"""
    residual_Nm: Moment
    """yaw moment, observed minus predicted, mean since the last message"""
    evidence: Dimensionless
    """log-likelihood ratio of a thrust loss that model mismatch does not explain"""
    thrust_loss: tuple[Share, Share]
    """most likely lost share of the thrust: port, starboard"""
    alarm: bool
    """the vehicle does not move as its model predicts"""
    why: str
    """reason of the alarm"""


class InputReport(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """State of one input of the controller."""

    input: str
    """key of the input"""
    alive: bool
    """a message arrived recently"""
    valid: bool
    """the stamp of the newest message is current"""
    rate: bool
    """at most half of the recent messages are missing"""
    age_ns: Time | None
    """age of the newest message; null before the first"""
    period_ns: Duration
    """median spacing of the stamps; 0 before the second"""
    rejected: Count
    """messages rejected so far: out of order or implausible"""


class ClockStep(Message, frozen=True, kw_only=True, eq=False):
    """Step of the clock of a publisher, as the controller recognised it. Its vehicle time runs on without a step."""

    t_ns: Time
    """time of the recognition"""
    input: str
    """key of the message that showed it"""
    publisher: Identifier
    """epoch of the publisher"""
    step_ns: Time
    """change of its clock, positive if it was set forward"""
    certain: bool
    """false: seen by constant lateness alone, which a congested link can cause: degraded for 10 s"""


class ClockMode(enum.StrEnum):
    """Source of vehicle time in a process."""

    SHARED = "shared"  # the ``clock`` topic, or the own clock if no stamps of others are compared with it
    TWO_WAY = "two-way"  # the clock of the other side, by a two-way exchange
    ONE_WAY = "one-way"  # the clock of the other side, by its stamps alone: behind by an unknown delay


class ControllerStatus(Message, frozen=True, kw_only=True, eq=False):
    """Status of the controller: inputs, cycle times, authority. Times are those of the last 10 s."""

    t_ns: Time
    """time of publication"""
    estimate_age_ns: Time | None
    """age of the newest estimate; null before the first"""
    applied_age_ns: Time | None
    """age of the newest applied message; null before the first: plans are assumed to be followed"""
    cycle_median_us: WallTime | None
    """from the start of a cycle to its plan, median of 10 s; null: no cycle"""
    cycle_p99_us: WallTime | None
    """99th percentile of the same"""
    received: Count
    """messages accepted so far"""
    dropped: Count
    """messages lost so far, by gaps in the sequences"""
    rejected: dict[str, Count]
    """messages rejected so far, by reason"""
    clock: ClockMode
    """source of vehicle time in the controller"""
    clock_error_ns: Duration | None
    """bound of the clock error; null: one-way, where it is unknown"""
    clock_steps: Count = 0
    """steps of the publishers' clocks so far"""
    checkpoints_failed: Count = 0
    """checkpoints that could not be written so far"""
    authority: Authority
    """source of the thrust commands"""
    health: Health
    """timeliness of the inputs of the controller"""
    health_why: str = ""
    """reason of the health; empty if it is nominal"""
    mission_action: MissionAction = MissionAction.GO_ON
    """action of the mission policy"""
    error_m: Position | None
    """horizontal distance of the newest estimate from the reference; null: no reference in force"""
    progress: Share | None = None
    """completed share of the reference; null if the reference has no end"""
    arrived: bool = False
    """the vehicle has come to the end of the reference, and not its target alone"""
    inputs: tuple[InputReport, ...] = ()
    """inputs whose age is monitored"""
    source: SourceChoice = ""
    """name of the source of the estimates in use; empty before the first"""
    source_epoch: Identifier = 0
    """epoch of that source; 0 before the first"""
    rejected_epoch: Identifier = 0
    """epoch of a second source that publishes on its key and is rejected; 0: none"""
    rejected_estimates: Count = 0
    """estimates of second sources rejected so far"""


class ReferenceStart(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Time, position and motion of the vehicle at the start of a reference."""

    t_ns: Time
    """time at which the reference started"""
    north_m: Position
    """position north of the origin"""
    east_m: Position
    """position east of the origin"""
    depth_m: Depth
    """depth below the surface"""
    heading_rad: Angle
    """true heading, clockwise from north seen from above"""
    velocity_mps: tuple[Speed, Speed]
    """over ground: north, east"""


class DisturbanceState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Belief of the disturbance observer, 12 states in the order of ``control/disturbance_filter.py``."""

    mean: FilterStates
    """current's bias north, east (m/s); lever arm forward, starboard (m); logarithms of the factors of mass ahead,
    abeam, inertia, drag ahead, abeam, in yaw; added Munk mass over mass; yaw moment over inertia (rad/s2)
    """
    covariance: CovarianceMatrix
    """12 x 12, of these states"""


class MissionState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """State of the mission policy: start of the mission, last sign of the operator, and the action in force."""

    start_t_ns: Time | None = None
    """start of the mission time; null: not armed yet"""
    operator_t_ns: Time | None = None
    """last sign of an operator; null: none yet"""
    action: MissionAction = MissionAction.GO_ON
    """action in force"""
    why: str = ""
    """cause of the action; empty if it is to go on"""
    skipped: tuple[str, ...] = ()
    """names of causes without effect: a forced `arm` skipped them"""


class ControllerState(Message, frozen=True, kw_only=True, eq=False):
    """State of a controller between two cycles: authority, reference, last plan, and what it has learned.

    The controller publishes it every 5 s and at each change of authority or reference. A controller that replaces a
    dead one receives the newest state as its first message. It comes from the supervisor, which has replaced ``plan``
    by the plan that is in force at that time, or from the checkpoint of --state.
    """

    t_ns: Time
    """time of publication"""
    authority: Authority = Authority.DISARMED
    """source of the thrust commands"""
    reference_toml: ReferenceText = ""
    """current reference, in the format of a reference file; empty: the reference of the start"""
    reference_start: ReferenceStart | None = None
    """start of the reference; null before it is in force"""
    fence_toml: ReferenceText = ""
    """fence in force, as a fence file holds it; empty: none"""
    arm_continues: bool = False
    """the next arm continues the reference: a restart, and no operator, has disarmed"""
    schedule_t_ns: Time = 0
    """time at which schedule_s was valid: first knot of the last plan"""
    schedule_s: ScheduleTime = 0.0
    """time of the target on the schedule of the reference"""
    schedule_rate: Share = 1.0
    """rate of schedule time to vehicle time; below 1 the target waits"""
    progress: Share | None = None
    """completed share of the reference; null if the reference has no end"""
    arrived: bool = False
    """the vehicle has come to the end of the reference, and not its target alone"""
    depth_integral_N: Force = 0.0
    """integral of the depth law: the vertical thrust that holds a depth"""
    plan_delays_ns: Durations = ()
    """of the last plans: from the start of the cycle to arrival at the actuators"""
    cycle_times_ns: Durations = ()
    """of the last cycles: computing time alone"""
    disturbance: DisturbanceState | None = None
    """what the controller has learned of water and vehicle; null: nothing"""
    model_products: ModelProductMatrix | None = None
    """6 x 6 sums of products of missing impulse and of its five regressors"""
    thrust_shares: tuple[ThrustShare, ThrustShare] = (1.0, 1.0)
    """share of the reported thrust that port and starboard deliver; below 1: a weak thruster"""
    plan: Plan | None = None
    """last plan sent; after a restart, the plan in force at the actuators"""
    estimate: Estimate | None = None
    """newest estimate, of the vehicle's origin"""
    source: SourceChoice = ""
    """name of the source that an operator has chosen; else empty"""
    mission: MissionState = MissionState()
    """state of the mission policy"""


# --- written by the actuators ----------------------------------------------------------------------------------------


class Applied(Message, frozen=True, kw_only=True, eq=False):
    """Report of the actuators to the controller: the thrusts they deliver and the plan they follow."""

    t_ns: Time
    """time of validity and of publication"""
    thrust_N: Forces
    """delivered, after lag and saturation: port, starboard, vertical"""
    command_N: Forces
    """command in force: port, starboard, vertical"""
    command_slew_N_per_s: ForceRates
    """largest rate of change of the command since the last report; 0: unknown"""
    plan_epoch: Identifier
    """epoch of the newest accepted plan; 0 before the first"""
    plan_sequence: SequenceOrNone
    """sequence of the newest accepted plan; -1 before the first"""
    plan_cycle_t_ns: Time
    """cycle_t_ns of the newest accepted plan; 0 before the first"""
    plan_received_t_ns: Time
    """arrival of the newest accepted plan; 0 before the first"""
    plan_late: bool
    """that plan arrived after its own first knot: a deadline miss"""
    plans_late: Count
    """late plans so far"""
    plans_rejected: Count
    """plans rejected so far: outside box or slew limit, out of order, or of a second controller"""
    health: Health = Health.NOMINAL
    """timeliness of the plans: degraded if two are missing, failsafe after the end of the last one"""
    why: Annotated[str, Meta(max_length=200)] = ""
    """why the plans are not followed, such as a released autopilot; empty: they are"""


# --- written by the vehicle's monitors of battery and leaks -----------------------------------------------------------


class Battery(Message, frozen=True, kw_only=True, eq=False):
    """State of the battery. It has no time: the controller uses the time of arrival."""

    voltage_V: Voltage
    """voltage under the present load"""
    remaining: Share | None = None
    """remaining share of the energy; null: unknown"""


class Leak(Message, frozen=True, kw_only=True, eq=False):
    """State of the leak detectors. It has no time: the controller uses the time of arrival."""

    detected: bool
    """water in the hull"""


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

    command_id: Identifier
    """chosen by the sender, repeated in the reply; 48 random bits are unique"""
    action: Action
    """requested action"""
    reference_toml: ReferenceText = ""
    """for follow: contents of a reference file, TOML"""
    fence_toml: ReferenceText = ""
    """for fence: contents of a fence file, TOML; empty: no fence from now on"""
    force: bool = False
    """for arm: arm although pre-arm checks fail"""
    source: SourceChoice = ""
    """for source: its name, `default` for the plain key; empty: the order of the settings"""


class Obstacles(Message, frozen=True, kw_only=True, eq=False):
    """Reports of obstacles, of any source (AIS, sonar). An obstacle that is not reported again is dropped when old."""

    t_ns: Time
    """time of publication"""
    obstacles: Annotated[tuple[Obstacle, ...], Meta(max_length=64)]
    """some or all obstacles"""


class Heartbeat(Message, frozen=True, kw_only=True, eq=False):
    """Sign of life of an operator. Commands and messages of a pilot count as one too."""


class Manual(Message, frozen=True, kw_only=True, eq=False):
    """Thrusts that a pilot requests. They are valid for 1 s after arrival, then the thrusts return to zero."""

    thrust_N: Forces
    """requested: port, starboard, vertical; valid for 1 s after arrival"""


class ClockCommand(Message, frozen=True, kw_only=True, eq=False):
    """Command to pause vehicle time or change its speed. The simulated vehicle, which keeps the time, reads it."""

    paused: bool
    """vehicle time stands still"""
    speed: SpeedOfTime
    """vehicle seconds per wall second"""


class Disturbance(Message, frozen=True, kw_only=True, eq=False):
    """External force, moment and thrust loss that act on the simulated vehicle.

    It acts from its arrival until ``end_t_ns`` and replaces the one before it. No process aboard the vehicle reads it.
    """

    end_t_ns: Time
    """vehicle time at which it ends"""
    thrust_scale: Shares = (1.0, 1.0, 1.0)
    """ratio of delivered thrust to that of the propellers: port, starboard, vertical"""
    force_N: Forces = (0.0, 0.0, 0.0)
    """on the vehicle: north, east, down"""
    yaw_moment_Nm: Moment = 0.0
    """about down, positive to starboard"""


class Kill(Message, frozen=True, kw_only=True, eq=False):
    """Command to the supervisor of a simulation to kill one process, to test the reaction of the others."""

    node: str
    """node whose process is killed"""


# --- written by every process: status, events, rejected frames, a record of each step --------------------------------


class NodeStatus(Message, frozen=True, kw_only=True, eq=False):
    """Status of one process: readiness, counters, and what it waits for."""

    node: str
    """node that publishes this message"""
    t_ns: Time
    """time of publication"""
    ready: bool
    """the node can do its work"""
    waiting_for: str = ""
    """what the node waits for; empty if nothing"""
    steps: Count = 0
    """steps so far"""
    published: Count
    """messages published so far, on all keys"""
    received: Count = 0
    """messages accepted so far"""
    dropped: Count = 0
    """messages lost so far, by gaps in the sequences"""
    rejected: Count = 0
    """messages rejected so far"""
    step_us: WallTime = 0.0
    """mean wall time of a step since the last status"""
    min_queue_delay_us: WholeWallTime = 0
    """smallest wall time that a message waited since the last status; above 0: a standing queue"""
    finished: bool = False
    """the node has done all its work; this is its last status"""


class NodeSettings(Message, frozen=True, kw_only=True, eq=False):
    """Settings of a process that runs aboard: a replay builds its node again from them.

    The process publishes them at its start, at its first step and every 10 s: a recorder may start before or after it.
    """

    node: str
    """node that publishes this message"""
    files: dict[str, str]
    """settings files by path, such as config/vehicle.toml"""
    made_by: dict[str, str]
    """versions, commit and processor"""


class RunEvent(Message, frozen=True, kw_only=True, eq=False):
    """Event to be marked on the time axis: a phase, a loss, a restart."""

    t_ns: Time
    """time of the event"""
    node: str
    """node that publishes this message"""
    kind: str
    """kind of the event, one word"""
    text: str
    """description of the event"""


class RejectedFrame(Message, frozen=True, kw_only=True, eq=False):
    """Frame that the message validation of a node rejected."""

    t_ns: Time
    """time of arrival"""
    node: str
    """node that publishes this message"""
    key: str
    """key of the message, without the namespace"""
    reason: str
    """reason of the rejection, with the field and its bound"""
    crc: Identifier
    """CRC-32 of the payload"""
    payload_base64: str
    """first bytes of the frame, at most 3072"""


class InboxEntry(msgspec.Struct, frozen=True, array_like=False, kw_only=True, forbid_unknown_fields=True):
    """Reference to one message in the inbox of a step, sufficient to find its frame in the recording."""

    key: str
    """key of the message, without the namespace"""
    epoch: Identifier
    """epoch in the header of the message"""
    sequence: Count
    """sequence in the header of the message"""
    crc: Identifier
    """CRC-32 of the payload"""
    received_t_ns: Time
    """time of arrival"""
    shift_ns: Time = 0
    """vehicle time minus the time of its publisher, added to the times in the message"""


class RecordedStep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One step of a node: all that it received."""

    t_ns: Time
    """time of the step"""
    cause: str
    """grid, cycle, or the key of the message that caused the step"""
    inbox: tuple[InboxEntry, ...]
    """messages that the step received, in order"""
    shift_ns: Time = 0
    """time of the actuators minus vehicle time, added to the times in the outputs"""


class StepRecord(Message, frozen=True, kw_only=True, eq=False):
    """Record of consecutive steps of a node, published before their outputs. An exact replay needs it."""

    node: str
    """node that publishes this message"""
    epoch: Identifier
    """epoch of the node, as in its headers"""
    step: Count
    """number of the first step; the node's first one has number 0"""
    steps: tuple[RecordedStep, ...]
    """the steps, in order"""


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

    clock_epoch: Identifier
    """identifies one start of the clock master"""
    clock_sequence: Count
    """number of the announcement; a repetition keeps its number"""
    host_boot_id: str
    """boot of the host of the clock master; monotonic times are comparable within one boot"""
    at_monotonic_us: MonotonicTime
    """CLOCK_MONOTONIC from which this relation holds"""
    vehicle_ns: Time
    """vehicle time at that instant"""
    speed_num: PositiveInteger
    """speed in force, numerator"""
    speed_den: PositiveInteger
    """speed in force, denominator"""
    requested_speed: SpeedOfTime
    """requested vehicle seconds per wall second; the speed in force may be lower"""
    state: ClockState
    """state of vehicle time from then on"""
