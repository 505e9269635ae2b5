"""Every message, one struct each: what nodes read and write, and what travels.

Frames: world NED (north, east, down), body FRD (forward, starboard, down). SI units and radians, also on the wire.
Times: ``t_ns`` is vehicle time in integer nanoseconds, 0 at the start of the descent (negative while afloat before it).
Thrusts are in the order port, starboard, vertical (N). The signal's TYPE is the port: a node names the types it reads.
The key, rate, delivery and writer of each are in ``services/bus/topics.py``; what makes one acceptable is in
``admission.py``.
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
# What a description of the wire cannot see in an array's type: whole numbers, and rows in rows.
Matrix: TypeAlias = Annotated[Array, Meta(extra_json_schema={"items": {"type": "array"}})]
Times: TypeAlias = Annotated[npt.NDArray[np.int64], Meta(extra_json_schema={"items": {"type": "integer"}})]
Pair: TypeAlias = tuple[float, float]
Triple: TypeAlias = tuple[float, float, float]


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

    t_ns: int
    position_m: Triple  # NED
    velocity_mps: Triple  # NED, over ground
    attitude_rad: Triple  # roll, pitch, heading
    water_velocity_mps: Triple  # surge, sway, heave relative to the water, in the level heading frame
    yaw_rate_radps: float
    current_mps: Pair  # north, east, at the vehicle
    thrust_N: Triple  # delivered


class Disturbance(Message, frozen=True, kw_only=True, eq=False):
    """What acts on the simulated vehicle besides water and propellers, from its arrival on until ``until_t_ns``.

    A new one takes the old one's place; nothing aboard reads it.
    """

    until_t_ns: int
    thrust_scale: Triple = (1.0, 1.0, 1.0)  # delivered thrust over what the propellers would give
    force_N: Triple = (0.0, 0.0, 0.0)  # NED
    yaw_moment_Nm: float = 0.0  # about down, positive to starboard


class Harm(enum.StrEnum):
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

    key: str
    harm: Harm
    start_t_ns: int
    end_t_ns: int
    size: float = 1.0
    seed: int = 0


class Applied(Message, frozen=True, kw_only=True, eq=False):
    """What the thrusters do, and which plan they follow: the actuators' report to the controller."""

    t_ns: int
    thrust_N: Triple  # by eq 8 from the revolutions, after lag and saturation
    command_N: Triple  # in force
    command_slew_N_per_s: Triple  # largest |d command / dt| since the last report
    plan_epoch: int  # of the plan accepted last; 0 before the first
    plan_sequence: int  # of the plan accepted last; -1 before the first
    plan_cycle_t_ns: int  # start of the cycle that made it, as the plan says; 0 before the first
    plan_received_t_ns: int  # when it arrived
    plan_late: bool  # it arrived after its start time: a deadline miss
    plans_late: int  # so far
    plans_refused: int  # so far: outside box or slew, out of order, or a second commander's
    health: Health = Health.NOMINAL  # how well the plans keep up


# --- sensors ---------------------------------------------------------------------------------------------------------


class ImuSample(Message, frozen=True, kw_only=True, eq=False):
    """Increments of a strapdown IMU divided by the interval that ends at ``t_ns``: means over it, body frame."""

    t_ns: int
    interval_ns: int
    angular_rate_radps: Triple
    specific_force_mps2: Triple


class GnssFix(Message, frozen=True, kw_only=True, eq=False):
    """Position and velocity over ground, at the surface."""

    t_ns: int
    north_m: float
    east_m: float
    velocity_north_mps: float
    velocity_east_mps: float


class TdcpFix(Message, frozen=True, kw_only=True, eq=False):
    """Change of position between two epochs from time-differenced carrier phase, at the surface."""

    t_ns: int
    from_t_ns: int
    north_m: float
    east_m: float


class AdcpPing(Message, frozen=True, kw_only=True, eq=False):
    """Velocity of the water relative to the transducer along each beam, positive away from the vehicle.

    ``range_m`` (K,) is the slant range of each cell's centre; ``beam_velocity_mps`` is (4, K); NaN (null on the wire)
    where a beam has no return.
    """

    t_ns: int
    range_m: Array
    beam_velocity_mps: Matrix


class PressureDepth(Message, frozen=True, kw_only=True, eq=False):
    """Depth below the surface from pressure."""

    t_ns: int
    depth_m: float


class CompassHeading(Message, frozen=True, kw_only=True, eq=False):
    """True heading from a magnetic compass, deviation and declination already taken off, (-pi, pi]."""

    t_ns: int
    heading_rad: float


class BottomTrack(Message, frozen=True, kw_only=True, eq=False):
    """Velocity of the sea bed relative to the transducer along each beam, positive away from the vehicle.

    ``range_m`` (4,) is the slant range to the bottom; both are NaN (null on the wire) for a beam that has not found it.
    """

    t_ns: int
    range_m: Array
    beam_velocity_mps: Array


class LblRange(Message, frozen=True, kw_only=True, eq=False):
    """Two-way travel time to a transponder: half of it is a range, at the middle between interrogation and reply."""

    t_ns: int  # that middle
    transponder: int  # its place in the sensors file, from 0
    travel_time_s: float  # there and back, the transponder's turn-around time already taken off


class UsblFix(Message, frozen=True, kw_only=True, eq=False):
    """Position over ground that a ship measured acoustically and sent down; it arrives later than it is valid."""

    t_ns: int  # of validity
    north_m: float
    east_m: float


# --- aboard ----------------------------------------------------------------------------------------------------------


class CurrentProfile(Message, frozen=True, kw_only=True, eq=False):
    """Horizontal water velocity over depth; linear between depths, constant beyond both ends. All arrays (K,)."""

    depth_m: Array
    north_mps: Array
    east_mps: Array
    sd_mps: Array | None = None


class Estimate(Message, frozen=True, kw_only=True, eq=False):
    """Where the vehicle is and how it moves over ground.

    ``covariance`` is (6, 6) over north, east (m), velocity north, east (m/s), heading (rad), yaw rate (rad/s).
    """

    t_ns: int
    north_m: float
    east_m: float
    heading_rad: float
    yaw_rate_radps: float
    velocity_north_mps: float
    velocity_east_mps: float
    depth_m: float | None = None
    velocity_down_mps: float | None = None
    covariance: Matrix | None = None
    current: CurrentProfile | None = None

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
    UNFORESEEN = "unforeseen"  # water that nothing foretold: cells may be worse than said, or have been granted a walk
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

    sensor: str
    status: SensorStatus
    used: int  # scalar measurements that corrected the filter
    refused: dict[str, int]  # by reason: gate, late, no_return, outside_grid, ...
    nis: float | None
    last_t_ns: int | None  # validity time of its newest message


class LocalisationReport(Message, frozen=True, kw_only=True, eq=False):
    """The localisation filter's word about itself and its sensors."""

    t_ns: int
    status: FilterStatus
    why: str  # empty while nominal
    restarts: int  # of the filter, so far
    water_walk_mps_per_rts: float  # granted to the water beyond the settings, because innovations asked for it; 0: none
    sensors: tuple[SensorReport, ...]


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

    input: str  # its key
    alive: bool  # heard lately
    valid: bool  # what was heard last is of now, by its own stamp
    rate: bool  # of what came lately, no more than half was missing
    age_ns: int | None  # of what was heard last; None before the first
    period_ns: int  # median spacing of the stamps; 0 before the second
    refused: int  # out of order, or not to be believed, so far


class Solve(Message, frozen=True, kw_only=True, eq=False):
    """The solver's account of one solve; residuals are those of the scaled problem."""

    status: SolveStatus
    iterations: int = 0
    primal_residual: float = 0.0
    dual_residual: float = 0.0
    why: str = ""


class Plan(Message, frozen=True, kw_only=True, eq=False):
    """Thrusts to come: piecewise linear through knots, enough to run the actuators to its end without another word.

    ``t_ns`` (N+1,) knots; the plan takes effect at the first. ``thrust_N`` (N+1, 3) commands. ``states`` (N+1, 6)
    predicted n, e (m), u, v (m/s, relative to the water), heading (rad), yaw rate (rad/s).
    """

    cycle_t_ns: int  # start of the cycle that made it
    t_ns: Times
    thrust_N: Matrix
    states: Matrix
    origin: PlanOrigin
    solve: Solve
    why: str = ""  # of the origin, where it is not "solved"
    authority: Authority = Authority.CONTROLLER
    health: Health = Health.NOMINAL
    estimate_t_ns: int = 0  # validity time of the estimate it is built on
    expected_delay_ns: int = 0
    reference_m: Pair | None = None  # north, east of the target at the first knot; None before the start
    reference_depth_m: float | None = None  # that it ends at
    progress: float | None = None  # of a path: the share that the target has behind it, 0 .. 1
    cross_track_m: float | None = None  # of the vehicle at the first knot, from the path, positive to starboard of it
    remaining_m: float | None = None  # of the path, before the target

    def thrust_at(self, t_ns: int) -> Array:
        """Commanded thrust (3,) at ``t_ns``, linear between knots, constant beyond both ends."""
        i = int(np.clip(np.searchsorted(self.t_ns, t_ns, side="right") - 1, 0, len(self.t_ns) - 2))
        t0, t1 = int(self.t_ns[i]), int(self.t_ns[i + 1])
        s = min(max((t_ns - t0) / (t1 - t0), 0.0), 1.0)
        thrust: Array = self.thrust_N[i] + s * (self.thrust_N[i + 1] - self.thrust_N[i])
        return thrust


# --- who is in charge -------------------------------------------------------------------------------------------------


class Command(Message, frozen=True, kw_only=True, eq=False):
    """What an operator asks: answered by an ``Acknowledged`` of the same ``command_id``."""

    command_id: int  # the sender's choice; 48 random bits are told apart from every other's
    action: Action
    reference_toml: str = ""  # of "follow": what a reference file holds, as TOML


class Manual(Message, frozen=True, kw_only=True, eq=False):
    """Thrusts that a pilot asks for. They count for a second from their arrival, then the thrusters go to zero."""

    thrust_N: Triple


class Acknowledged(Message, frozen=True, kw_only=True, eq=False):
    """The controller's answer to a ``Command``."""

    t_ns: int
    command_id: int
    accepted: bool
    authority: Authority  # after it
    why: str  # it was refused; empty where it was accepted


# --- how the run itself goes: times, records, faults -----------------------------------------------------------------


class CycleTiming(Message, frozen=True, kw_only=True, eq=False):
    """What one controller cycle cost, measured by whoever called it (zero work in lock step, where the delay is set).

    ``stage_us`` is wall time by name: predict, linearise, build, update, solve, read, publish. ``compute_ns`` is
    vehicle time from the start of the cycle to its plan's publication, ``compute_wall_ns`` the same on the wall.
    """

    t_ns: int  # start of the cycle
    compute_ns: int
    compute_wall_ns: int
    estimate_age_ns: int  # at the start of the cycle
    stage_us: dict[str, float]


class Rejected(Message, frozen=True, kw_only=True, eq=False):
    """A frame that was refused at a node's door."""

    t_ns: int
    node: str
    key: str
    reason: str
    crc: int
    payload_base64: str  # at most 4 KiB of it


class Handed(Message, frozen=True, kw_only=True, eq=False):
    """A frame between `ltv-mpc inject` and the node under test that is not what travels on its key for all others.

    What the node is given in the place of a message that was harmed, or what it said itself before that was harmed.
    """

    t_ns: int
    key: str
    crc: int  # of the frame
    payload_base64: str  # all of it


class ReferenceStart(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where and when a reference began, and how the vehicle moved then."""

    t_ns: int
    north_m: float
    east_m: float
    depth_m: float
    heading_rad: float
    velocity_mps: Pair  # north, east, over ground


class ControllerCheckpoint(Message, frozen=True, kw_only=True, eq=False):
    """What a controller that is started anew needs beside the plan in force: who is in charge, what is followed, and
    what was learned of the vehicle's buoyancy, of delays and of how it differs from its model.
    """

    t_ns: int
    authority: Authority
    reference_toml: str  # as a reference file holds it
    began: ReferenceStart | None  # None before the reference is in force
    schedule_s: float = 0.0  # how far the target has come: the time of the reference's own schedule
    schedule_rate: float = 1.0  # of that time to the vehicle's
    progress: float | None = None  # of a path, 0 .. 1
    depth_integral_N: float = 0.0  # of the depth law: the vertical thrust at rest
    plan_delays_ns: tuple[int, ...] = ()  # of the last plans, from the start of their cycle to their arrival
    cycle_times_ns: tuple[int, ...] = ()  # of the last cycles, computing alone
    model_products: Matrix | None = None  # (4, 4), of what was missing and its three likely reasons: safety/evidence.py


class DroppedNode(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of a depth whose water is no state any more: ``Link`` of ``localisation/column.py``, flat."""

    node: int  # of the grid of depths
    velocity_mps: Pair  # c, north and east
    given: Array  # g of then, (q,)
    regression: Matrix  # A, (2, q)
    covariance: Matrix  # C, (2, 2)
    with_position: Matrix  # B, (2, 2)
    position: Matrix  # S, (2, 2)
    walked: float  # variance that each depth had gained by then, m2/s2


class EstimatorCheckpoint(Message, frozen=True, kw_only=True, eq=False):
    """What the localisation filter goes on from: its belief, n states in the order of ``localisation/state.py``.

    ``covariance`` holds the lower triangle row by row, (n (n + 1) / 2,). Another setting of sensors or filter may mean
    other states, so a checkpoint belongs to the ``settings`` it was made with: their CRC-32.
    """

    t_ns: int
    settings: int
    x: Array  # (n,)
    attitude: Matrix  # (3, 3), body to NED
    mounting: Matrix  # (3, 3), profiler to body
    covariance: Array
    epoch_t_ns: int  # of the satellite epoch that x holds a clone of
    first_node: int  # of the window of depths
    seen_nodes: Times  # depths that the profiler has measured at
    dropped: tuple[DroppedNode, ...]
    walked: float  # variance that each depth has gained by walking in time, m2/s2
    restarts: int  # of the filter, so far


class Restore(Message, frozen=True, kw_only=True, eq=False):
    """State that a supervisor handed to a node it has started anew: the first entry of its new epoch's inbox."""

    t_ns: int  # when it was handed over
    node: str
    plan: Plan | None = None  # in force at the actuators
    estimate: Estimate | None = None  # the newest one
    controller: ControllerCheckpoint | None = None
    estimator: EstimatorCheckpoint | None = None


class InboxEntry(msgspec.Struct, frozen=True, array_like=False, kw_only=True, forbid_unknown_fields=True):
    """One entry of a step's inbox as the record keeps it: enough to find the frame again."""

    key: str
    epoch: int
    sequence: int
    crc: int
    received_t_ns: int


class StepRecord(Message, frozen=True, kw_only=True, eq=False):
    """One step of one node, published before the step's outputs: what an exact replay needs."""

    node: str
    epoch: int
    step: int
    t_ns: int
    cause: str  # "grid", "cycle" or the key of the message that caused it
    inbox: tuple[InboxEntry, ...]


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

    clock_epoch: int
    clock_sequence: int
    host_boot_id: str
    at_monotonic_us: int
    vehicle_ns: int
    speed_num: int
    speed_den: int
    asked_speed: float  # vehicle seconds per second of the wall; the machine may allow less
    state: ClockState


class ClockCommand(Message, frozen=True, kw_only=True, eq=False):
    """How vehicle time shall go on, asked of the simulated vehicle that keeps it."""

    paused: bool
    speed: float  # vehicle seconds per second, of the wall


class ClockMode(enum.StrEnum):
    """By what a process knows the time."""

    SHARED = "shared"  # the ``clock`` topic, or a clock of its own that nobody else's stamps are held against
    TWO_WAY = "two-way"  # the other side's clock, by an exchange
    ONE_WAY = "one-way"  # the other side's clock, by its stamps alone: behind by an unknown delay


class NodeStatus(Message, frozen=True, kw_only=True, eq=False):
    """One process's word about itself: that it is ready, what it counts, what it waits for."""

    node: str
    t_ns: int
    ready: bool
    waiting_for: str
    steps: int
    published: int
    received: int
    dropped: int
    rejected: int
    step_us: float  # mean wall time of a step since the last status
    behind_us: int = 0  # least wall time that a message waited since the last status: a queue that stands
    finished: bool = False  # it has done all that it was asked for


class ControllerStatus(Message, frozen=True, kw_only=True, eq=False):
    """How the controller fares: its inputs, its cycles, who is in charge. Times are those of the last 10 s."""

    t_ns: int
    estimate_age_ns: int | None  # of the newest estimate; None before the first
    applied_age_ns: int | None  # of the actuators' newest report; None: its plans are assumed to be followed
    cycle_median_us: float | None  # from the start of a cycle to its plan, on the wall; None where there was none
    cycle_p99_us: float | None
    received: int  # messages let in so far
    dropped: int  # that were sent and never came, by their sequences
    rejected: dict[str, int]  # by reason
    clock: ClockMode
    clock_error_ns: int | None  # at most so far off; None: one-way, where nobody can tell
    authority: Authority
    health: Health
    error_m: float | None  # horizontal, from the newest estimate to the reference; None where nothing is followed
    progress: float | None = None  # along the reference, 0 to 1; None where it has no end
    inputs: tuple[InputReport, ...] = ()  # whose ages count


class Kill(Message, frozen=True, kw_only=True, eq=False):
    """End one process of a simulation without warning, to see what the others do: asked of its launcher."""

    node: str


class ModelCheck(Message, frozen=True, kw_only=True, eq=False):
    """How far the vehicle does what its model says: the motion from one estimate to the next, seen less foreseen."""

    t_ns: int
    residual_N: float  # in surge, mean since the last word; below 0: it is pushed ahead by less than it should be
    residual_Nm: float  # in yaw
    evidence: float  # that thrust has been lost, beyond what mismatch explains: a log-likelihood ratio
    thrust_loss: Pair  # share of it that is most likely lacking, port and starboard
    alarm: bool  # it stays until the vehicle has done as its model says for a while
    why: str  # of the alarm


class RunEvent(Message, frozen=True, kw_only=True, eq=False):
    """Something worth a mark on the time axis: a phase, a loss, a restart."""

    t_ns: int
    node: str
    kind: str
    text: str


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
