"""Identification of a vehicle's coefficients from the estimates and actuator reports of a recorded run.

It reads the messages that a real vehicle also has: ``estimate``, ``applied``, and ``plan`` if there is no ``applied``.
The true state of a simulated run is not used. Pieces whose thrusts are not known are left out: without reports, and
with released thrusters, when someone else may move the vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from ltv_mpc import config
from ltv_mpc.control.prediction import current_at_depth, profile_of
from ltv_mpc.errors import ConfigError, naming
from ltv_mpc.messages import Applied, Array, Authority, Estimate, Pair, Plan, Times, Triple
from ltv_mpc.vehicle.identification import (
    CannotIdentify,
    Identification,
    IdentifiedCoefficient,
    Known,
    KnownYaw,
    NotEnoughMotion,
    identify,
    with_coefficients,
)
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.shooting_fit import MAX_GAP_S, SEGMENT_S, Motion
from services.recording.acceptance import accepted
from services.recording.reader import Recording
from services.recording.recover import segments
from services.run import folder
from services.run.folder import RunFolder
from services.runtime.console import columns
from services.tools import autopilot_log
from services.tools.autopilot_log import AutopilotLog

SD = np.array([0.01, 0.01, 0.005])
"""Standard deviations of u, v (m/s) and r (rad/s) without a covariance; the fit scales them to the run."""
Mask: TypeAlias = NDArray[np.bool_]
Timed = TypeVar("Timed", Estimate, Applied)

IDLE = 0.005
"""Share of the largest thrust of a thruster up to which it delivers nothing."""

WANTED = 0.05
"""Share of the largest thrust from which a plan wants thrust."""

MIN_SD = 1e-5
VELOCITY, YAW_RATE = (2, 3), 5
"""Indices in the covariance of an estimate."""


class IdentifyReport(Identification, frozen=True, kw_only=True):
    """Report of ``vehicle identify --json``."""

    run: str
    vehicle: str
    estimates: int
    left_out_s: float  # time of estimates whose thrusts are not known
    input: str  # "applied", "plan" or "pwm": where the thrusts come from
    known: tuple[Known, KnownYaw]  # coefficients taken from the file


def open_run(run: str) -> Path:
    """Return the recording of a run (its folder, its run.mcap or ``latest``), or the path of an autopilot's log.

    Raises ``ConfigError``.
    """
    return Path(run) if run.lower().endswith(autopilot_log.SUFFIXES) else folder.find(run)


def is_log(path: Path) -> bool:
    """Return True for an autopilot's log, by its name."""
    return path.suffix.lower() in autopilot_log.SUFFIXES


def load_vehicle(path: Path, name: str | None) -> Vehicle:
    """Load the named vehicle, or the run's own. Raises ``ConfigError``."""
    if name is None and is_log(path):
        raise ConfigError("option --vehicle", "", f"is needed: {path} has no vehicle file")
    return Vehicle.load(name or str(RunFolder(path.parent).config("vehicle")))


def identify_run(path: Path, vehicle: Vehicle, known: Known, known_yaw: KnownYaw) -> IdentifyReport:
    """Identify the vehicle from a recording or a log. Raises ``ConfigError`` if no vehicle can be fitted to it."""
    notes, to_origin = list[str](), vehicle.reference_point.to_origin
    try:
        if is_log(path):
            log = autopilot_log.read(path, vehicle)
            estimates, notes = list(map(to_origin, log.estimates)), log.notes
            motion = motion_of_log(estimates, log)
        else:
            recorded = list(accepted(Recording(*segments(path)), (Estimate, Applied, Plan)))
            estimates = [to_origin(message) for message, *_ in recorded if isinstance(message, Estimate)]
            reports = [message for message, *_ in recorded if isinstance(message, Applied)]
            plans = [(t_ns, message) for message, _, t_ns in recorded if isinstance(message, Plan)]
            motion = motion_of(vehicle, estimates, reports, plans)
        identification = identify(vehicle, motion, known, known_yaw)
    except CannotIdentify as error:
        problem = "does not excite the vehicle enough" if isinstance(error, NotEnoughMotion) else "cannot be fitted"
        raise ConfigError(name_of(path), "", f"{problem}: {error}") from None
    found = msgspec.structs.asdict(identification) | {"warnings": [*notes, *identification.warnings]}
    return IdentifyReport(
        **found,
        run=str(path if is_log(path) else path.parent),
        vehicle=vehicle.name,
        estimates=len(motion.t_s),
        left_out_s=_left_out_s(estimates, len(motion.t_s)),
        input="pwm" if is_log(path) else "plan" if motion.thrust is None else "applied",
        known=(known, known_yaw),
    )


def name_of(path: Path) -> str:
    """Return the name of a run or a log in errors."""
    return f"{'log' if is_log(path) else 'run'} {path}"


def motion_of_log(estimates: list[Estimate], log: AutopilotLog) -> Motion:
    """Return velocities and commands at the times of the estimates while the autopilot is armed.

    Raises ``NotEnoughMotion`` if there are fewer than two.
    """
    estimates = _sort_unique(estimates)
    t_ns = np.array([estimate.t_ns for estimate in estimates], dtype=np.int64)
    last = np.maximum(np.searchsorted(log.t_ns, t_ns, side="right") - 1, 0)
    known = _reported(t_ns, log.t_ns) & log.armed[last] & np.isfinite(log.command_N[last]).all(axis=1)
    return _motion(estimates, known, _interpolate(t_ns, log.t_ns, np.nan_to_num(log.command_N)), None)


def motion_of(
    vehicle: Vehicle, estimates: list[Estimate], applied: list[Applied], plans: list[tuple[int, Plan]]
) -> Motion:
    """Return water-relative velocities and thrusts at the times of the estimates for which both are known.

    Raises ``NotEnoughMotion`` if there are fewer than two.
    """
    estimates, reports = _sort_unique(estimates), _sort_unique(applied)
    plans = sorted(plans, key=lambda published: published[0])
    t_ns = np.array([estimate.t_ns for estimate in estimates], dtype=np.int64)
    largest_N = np.array([thruster.max_N for thruster in vehicle.thrusters[:2]])
    planned, in_force = _planned(t_ns, plans, vehicle.plan_timeout_s)
    thrust = None
    if reports:
        report_t_ns = np.array([report.t_ns for report in reports])
        known = _reported(t_ns, report_t_ns)
        command = _interpolate(t_ns, report_t_ns, np.array([report.command_N[:2] for report in reports]))
        thrust = _interpolate(t_ns, report_t_ns, np.array([report.thrust_N[:2] for report in reports]))
        idle: Mask = np.all(np.abs(thrust) <= IDLE * largest_N, axis=1)
        if plans:  # not released: a plan that is in force wants no thrust
            idle &= ~(in_force & np.all(np.abs(planned) <= WANTED * largest_N, axis=1))
        known &= ~_lasting(t_ns, idle, MAX_GAP_S if plans else SEGMENT_S)
    else:
        command, known = planned, in_force
    return _motion(estimates, known, command, thrust)


def _motion(estimates: list[Estimate], known: Mask, command: Array, thrust: Array | None) -> Motion:
    """Return the motion at the estimates (M,) whose thrust is known. Raises ``NotEnoughMotion``."""
    if np.count_nonzero(known) < 2:
        raise NotEnoughMotion(
            f"{np.count_nonzero(known)} of {len(estimates)} estimates have a known thrust, at least 2 are needed: "
            "record `applied`, or `plan` while the controller is armed"
        )
    usable = [estimate for estimate, use in zip(estimates, known, strict=True) if use]
    t_ns = np.array([estimate.t_ns for estimate in usable])
    velocity, shear = zip(*map(_through_the_water, usable), strict=True)
    return Motion(
        t_s=(t_ns - t_ns[0]) * 1e-9,
        velocity=np.array(velocity),
        heading=np.unwrap([estimate.heading_rad for estimate in usable]),
        shear=np.array(shear),
        command=command[known],
        sd=_sd(usable),
        thrust=None if thrust is None else thrust[known],
    )


def _reported(t_ns: Times, report_t_ns: Times) -> Mask:
    """Return for each time (M,) if it lies between two reports that are at most ``MAX_GAP_S`` apart."""
    last = np.searchsorted(report_t_ns, t_ns, side="right") - 1
    following = np.searchsorted(report_t_ns, t_ns, side="left")
    inside = (last >= 0) & (following < len(report_t_ns))
    apart_ns = report_t_ns[np.minimum(following, len(report_t_ns) - 1)] - report_t_ns[np.maximum(last, 0)]
    known: Mask = inside & (apart_ns <= MAX_GAP_S * 1e9)
    return known


def _lasting(t_ns: Times, true: Mask, seconds: float) -> Mask:
    """Return where (M,) ``true`` holds for longer than some seconds without a break."""
    lasting = np.zeros(len(true), dtype=bool)
    ends = np.flatnonzero(np.diff(true.astype(int), prepend=0, append=0))
    for first, end in zip(ends[::2], ends[1::2], strict=True):
        lasting[first:end] = t_ns[end - 1] - t_ns[first] > seconds * 1e9
    return lasting


def _left_out_s(estimates: list[Estimate], used: int) -> float:
    """Return the time of the estimates that are not used (s)."""
    times = np.unique([estimate.t_ns for estimate in estimates])
    return float(np.median(np.diff(times)) * 1e-9 * (len(times) - used))


def _sort_unique(messages: Sequence[Timed]) -> list[Timed]:
    """Sort by time and keep the newest message of each time."""
    ordered = sorted(messages, key=lambda message: message.t_ns)
    return list({message.t_ns: message for message in ordered}.values())


def _through_the_water(estimate: Estimate) -> tuple[Triple, Pair]:
    """Compute u, v, r,  [u, v] = R(psi)' (velocity over ground - current),  and the rate of the current (m/s2).

    The rate is that along the descent, dc/dz w, from the current 0.5 m above and below.
    """
    profile, depth_m = profile_of(estimate.current), estimate.depth_m or 0.0
    (n0, e0), (cn, ce), (n1, e1) = (current_at_depth(*profile, depth_m + off_m) for off_m in (-0.5, 0.0, 0.5))
    cos, sin = np.cos(estimate.heading_rad), np.sin(estimate.heading_rad)
    north, east = estimate.velocity_north_mps - cn, estimate.velocity_east_mps - ce
    w = 0.0 if estimate.depth_m is None else estimate.velocity_down_mps or 0.0
    return (cos * north + sin * east, cos * east - sin * north, estimate.yaw_rate_radps), ((n1 - n0) * w, (e1 - e0) * w)


def _interpolate(t_ns: Times, at_ns: Times, values: Array) -> Array:
    """Interpolate port and starboard (M, 2) linearly."""
    return np.column_stack([np.interp(t_ns, at_ns, column) for column in values.T])


def _planned(t_ns: Times, plans: list[tuple[int, Plan]], timeout_s: float) -> tuple[Array, Mask]:
    """Return port and starboard (M, 2) of the newest plan published by each time, and if it is in force (M,).

    No plan is in force while the controller drives no thruster, and after its last knot or ``timeout_s``.
    """
    thrust, in_force = np.zeros((len(t_ns), 2)), np.zeros(len(t_ns), dtype=bool)
    newest = np.searchsorted([published for published, _ in plans], t_ns, side="right") - 1
    for row, (k, t) in enumerate(zip(newest.tolist(), t_ns.tolist(), strict=True)):
        if k >= 0:
            plan = plans[k][1]
            thrust[row] = plan.thrust_at(t)[:2]
            ends = min(int(plan.t_ns[-1]), int(plan.t_ns[0]) + round(timeout_s * 1e9))
            in_force[row] = t <= ends and plan.authority in (Authority.CONTROLLER, Authority.MANUAL)
    return thrust, in_force


def _sd(estimates: list[Estimate]) -> Array:
    """Return standard deviations (3,) of u, v, r, the root mean square of the estimates' covariances."""
    covariances = [estimate.covariance for estimate in estimates if estimate.covariance is not None]
    if not covariances:
        return SD.copy()
    mean = np.mean([np.diag(covariance) for covariance in covariances], axis=0)
    velocity = float(mean[list(VELOCITY)].mean())
    return np.maximum(np.sqrt([velocity, velocity, float(mean[YAW_RATE])]), MIN_SD)


def identified_vehicle(path: Path, vehicle: Vehicle, report: IdentifyReport) -> Vehicle:
    """Return the vehicle with the identified coefficients. Raises ``ConfigError`` if a vehicle file rejects them."""
    with naming(name_of(path), problem="fits no vehicle that a file accepts: "):  # limits scaled beyond their bounds
        return with_coefficients(vehicle, report.coefficients)


def format_text(report: IdentifyReport) -> str:
    """Format the report as text."""
    u, v, r = report.residual_sd
    (north, east), (half_north, half_east) = report.current_mps, report.current_half_mps
    lines = [
        f"{report.vehicle}, {report.run}: {report.seconds:.0f} s, {report.estimates} estimates, "
        f"thrust from {report.input}"
        + (f"; {report.left_out_s:.1f} s without a known thrust left out" if report.left_out_s >= 0.05 else ""),
        f"residuals: {1e3 * u:.2f} mm/s ahead, {1e3 * v:.2f} mm/s to starboard, {1e3 * r:.2f} mrad/s",
        f"current that the estimates do not contain: {north:.3f} +- {half_north:.3f} m/s north, "
        f"{east:.3f} +- {half_east:.3f} m/s east",
        f"taken from the file: {report.known[0]} and {report.known[1]}",
        *columns([("", "file", "found", "95 % interval"), *map(_cells, report.coefficients)]),
    ]
    return "\n".join([*lines, *(f"warning: {warning}" for warning in report.warnings)])


def _cells(of: IdentifiedCoefficient) -> tuple[str, ...]:
    """Return the row of a coefficient in the table."""
    kept = ": declared value kept" if of.declared else "" if of.excited else ": not excited, file value kept"
    interval = f"{of.low:.4g} to {of.high:.4g} {of.unit}{kept}"
    return of.name, f"{of.file:.4g}", f"{of.value:.4g}" if of.excited else "", interval


def format_toml(report: IdentifyReport, vehicle: Vehicle) -> str:
    """Format the identified vehicle as a vehicle file."""
    not_excited = [one.name for one in report.coefficients if not one.excited and not one.declared]
    head = [
        f"# {vehicle.name}, {report.known[0]} and {report.known[1]} from the old file; the rest from",
        f"# {report.seconds:.0f} s of {Path(report.run).name}."
        + (f" Not excited, value of the old file: {', '.join(not_excited)}." if not_excited else ""),
        *(f"# warning: {warning}" for warning in report.warnings),
    ]
    return "\n".join(head) + "\n" + config.to_toml(vehicle)
