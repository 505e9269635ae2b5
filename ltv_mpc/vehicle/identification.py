"""System identification: masses, damping, thrust scale, arms, lags and reference point of a vehicle from its motion.

``shooting_fit.py`` states the least-squares problem. Here theta is found by scipy's trust region within physical
bounds; the standard deviations of the errors of u, v and r are scaled to the residuals.

The interval of theta_i is that of Student's t with the larger of two variances: that of white errors, H^-1, and that of
errors correlated within a segment but not between the S segments, H^-1 G H^-1 with G = S / (S - 1) sum_s g_s g_s'
(Liang & Zeger 1986). A constant current that the estimates do not contain is fitted beside the coefficients. Neither
variance covers other errors that last for the whole run. Forces that the model does not have are looked for by
``structure_check.py``; where they are present, the intervals contain the coefficients with and without them.

A coefficient that the run does not excite keeps the value of the file. The others are fitted again with it, so that the
identified vehicle is consistent in itself; their intervals remain those of the fit of all coefficients.

Identifiability: one factor on all masses, dampings and thrusts leaves the motion unchanged; so does one factor on
inertia, yaw damping and both arms. Therefore one of mass and thrust is taken from the file (``known``: by default
thrust), and one of inertia and arms (by default the arms, which can be measured with a ruler).
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import Literal, TypeAlias

import msgspec
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import norm
from scipy.stats import t as student

from ltv_mpc.messages import Array, Pair, Times, Triple
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.reference_point import ORIGIN
from ltv_mpc.vehicle.shooting_fit import (
    CURRENT_SD_MPS,
    LAGS,
    MAX_VALUE,
    PRIOR,
    REFERENCE_POINT,
    SEGMENT_S,
    STEP,
    Motion,
    ShootingFit,
    index_of,
    lagged_thrust,
    theta_scale,
    through_the_water,
)
from ltv_mpc.vehicle.structure_check import MAX_EXPLAINED, StructureCheck, check_structure, inverse

Known: TypeAlias = Literal["thrust", "mass"]
KnownYaw: TypeAlias = Literal["arm", "inertia"]

MIN_SEGMENTS = 5
MAX_RELATIVE_HALF_WIDTH = 0.5
"""Half width of the interval over the value in the file, up to which a coefficient counts as excited by the run."""

MAX_POINT_HALF_WIDTH_M = 0.1
"""Half width of the interval up to which the reference point counts as excited by the run."""

LAG_INTERPOLATION_ERROR = 0.02
"""Error of a lag, as a share of the time between two reports, because commands are not linear between them
(docs/identify.md).
"""

MIN_SIGNAL_TO_NOISE = 2.0
"""Root mean square of a velocity over the standard deviation of its errors, from which it counts as motion."""

STILL = np.array([0.002, 0.002, 0.001])
"""Standard deviations of u, v (m/s) and r (rad/s) below which a vehicle does not change its motion."""

CONFIDENCE = 0.95

MIN_SD = 1e-7
"""Smallest standard deviation of the errors of u, v (m/s) and r (rad/s): a vehicle at rest leaves no residual."""

MIN_MISFIT = 0.01
"""Residual over the root mean square of the velocity, from which a structure that does not fit is reported."""

MAX_RATIO = 3.0
"""Ratio of the residuals ahead and abeam from which they are reported as unequal."""

DIRECTIONS = ("ahead", "abeam", "in yaw")

CURRENT = slice(-2, None)
"""Places of the unmodelled current, north and east, in theta; the coefficients stand before them."""

FIELDS = {
    "mass_surge": ("surge.mass_kg", "kg"),
    "mass_sway": ("sway.mass_kg", "kg"),
    "inertia_yaw": ("yaw.inertia_kgm2", "kg m2"),
    "linear_surge": ("surge.linear_damping_kgps", "kg/s"),
    "quadratic_surge": ("surge.quadratic_damping_kgpm", "kg/m"),
    "linear_sway": ("sway.linear_damping_kgps", "kg/s"),
    "quadratic_sway": ("sway.quadratic_damping_kgpm", "kg/m"),
    "linear_yaw": ("yaw.linear_damping_Nms", "N m s"),
    "quadratic_yaw": ("yaw.quadratic_damping_kgm2", "kg m2"),
    "arm_port": ("thruster.port.arm_m", "m"),
    "arm_starboard": ("thruster.starboard.arm_m", "m"),
    "lag_port": ("thruster.port.lag_s", "s"),
    "lag_starboard": ("thruster.starboard.lag_s", "s"),
    "thrust": ("", ""),
    "reference_forward": ("reference_point.forward_m", "m"),
    "reference_starboard": ("reference_point.starboard_m", "m"),
}
"""Coefficients that can be fitted, with their keys in a vehicle file and their units; ``thrust`` is the factor on the
commands.
"""


class IdentifiedCoefficient(msgspec.Struct, frozen=True, kw_only=True):
    """Coefficient in the file and as identified, with its 95 % interval; ``thrust`` is a factor."""

    name: str
    unit: str
    file: float
    value: float
    low: float
    high: float
    excited: bool  # False: the run is not informative, or the value is declared; ``value`` is that of the file
    declared: bool = False  # ``value`` is the declared one, and ``low`` to ``high`` is what the run shows


class Identification(msgspec.Struct, frozen=True, kw_only=True):
    """Result of an identification."""

    coefficients: list[IdentifiedCoefficient]
    current_mps: Pair  # current that the estimates do not contain, north and east
    current_half_mps: Pair  # half width of its 95 % interval
    residual_sd: Triple  # standard deviations of the residuals of u, v (m/s) and r (rad/s)
    segments: int
    seconds: float
    warnings: list[str]  # what does not fit: structure of the model, declared values, bounds


class CannotIdentify(ValueError):
    """Error of a motion to which no vehicle can be fitted."""


class NotEnoughMotion(CannotIdentify):
    """Error of a run that is too short or too quiet for an identification."""


def identify(vehicle: Vehicle, motion: Motion, known: Known = "thrust", known_yaw: KnownYaw = "arm") -> Identification:
    """Identify the coefficients of a vehicle from a motion.

    Parameters
    ----------
    vehicle : vehicle with the values of the file. A reference point that it declares is not changed.
    motion : recorded motion of the vehicle's origin, computed with the reference point in the file.
    known : take thrust or surge mass from the file.
    known_yaw : take arms or yaw inertia from the file.

    Raises
    ------
    NotEnoughMotion
        If the motion has fewer than ``MIN_SEGMENTS`` segments, is constant, or excites no coefficient.
    CannotIdentify
        If the predicted motion diverges.
    """
    fixed = {"thrust"} if known == "thrust" else {"mass_surge"}
    fixed |= {"arm_port", "arm_starboard"} if known_yaw == "arm" else {"inertia_yaw"}
    fixed |= set() if motion.thrust is None else set(LAGS)
    free = [name for name in FIELDS if name not in fixed]
    fit, theta = _solve(vehicle, motion, free)
    unexcited_dofs = _below_noise(through_the_water(motion, CURRENT_SD_MPS * theta[CURRENT]), fit.sd)
    if any(_degree_of_freedom(name) in unexcited_dofs for name in free):
        fit, theta = _solve(vehicle, motion, [name for name in free if _degree_of_freedom(name) not in unexcited_dofs])
    check = check_structure(vehicle, motion, fit, theta)
    half_widths, low, high = _intervals(fit, theta, check)
    warnings = _structure_warnings(through_the_water(motion, CURRENT_SD_MPS * theta[CURRENT]), fit.sd, check.explained)
    full, kept_point = fit, set(REFERENCE_POINT) if vehicle.reference_point is not ORIGIN else set()
    narrow = _narrow(full.free, low, high)
    excited = [name for name in narrow if name not in kept_point]
    kept_point &= set(narrow)
    # the file's point is 0 in theta
    agrees = _fits(check) and all(low[i] <= 0.0 <= high[i] for i, name in enumerate(full.free) if name in kept_point)
    while len(excited) < len(fit.free):
        fit, best = _solve(vehicle, motion, excited)
        at = [*map(full.free.index, excited), -2, -1]
        theta = theta.copy()
        theta[at] = best
        if agrees:  # the intervals keep their widths
            low[at], high[at] = best - half_widths[at], best + half_widths[at]
        else:  # they contain the coefficients of both fits
            low[at] = np.minimum(low[at], best - half_widths[at])
            high[at] = np.maximum(high[at], best + half_widths[at])
            excited = [name for name in _narrow(full.free, low, high) if name in excited]
    intervals = dict(zip(full.free, zip(theta.tolist(), low.tolist(), high.tolist(), strict=True), strict=False))
    coefficients = [
        _coefficient(name, vehicle, intervals.get(name), excited=name in excited, declared=name in kept_point)
        for name in free
    ]
    if motion.thrust is not None:
        coefficients += _lags(vehicle, motion, motion.thrust, fit.edges)
    if not any(one.excited for one in coefficients):
        raise NotEnoughMotion("the motion of no coefficient exceeds the errors of the estimates (docs/identify.md)")
    return Identification(
        coefficients=coefficients,
        current_mps=tuple((CURRENT_SD_MPS * theta[CURRENT]).tolist()),
        current_half_mps=tuple((CURRENT_SD_MPS * 0.5 * (high - low)[CURRENT]).tolist()),
        residual_sd=tuple(fit.sd.tolist()),
        segments=len(fit.edges),
        seconds=float(motion.t_s[-1] - motion.t_s[0]),
        warnings=[*warnings, *_contradictions(coefficients), *_at_bounds(vehicle, coefficients)],
    )


def _solve(vehicle: Vehicle, motion: Motion, free: Sequence[str]) -> tuple[ShootingFit, Array]:
    """Return the fit of the coefficients ``free``, with ``sd`` scaled to the residuals, and its theta (P,)."""
    fit = ShootingFit(vehicle, motion, free)
    if len(fit.edges) < MIN_SEGMENTS:
        raise NotEnoughMotion(f"{len(fit.edges)} segments of {SEGMENT_S:g} s: at least {MIN_SEGMENTS} are needed")
    if np.all(np.std(motion.velocity, axis=0) < STILL):
        raise NotEnoughMotion("velocity and yaw rate are constant: move the vehicle (docs/identify.md)")
    lower, upper = fit.bounds
    theta = np.clip(fit.origin, lower + 1e-6, upper - 1e-6)
    for final in (False, False, True):
        if not np.all(np.isfinite(fit.residuals(theta))):
            speed, rate = np.abs(motion.velocity[:, :2]).max(), np.abs(motion.velocity[:, 2]).max()
            raise CannotIdentify(
                f"the predicted motion diverges from that of the log, up to {speed:.3g} m/s and {rate:.3g} rad/s: "
                "correct masses and damping in the vehicle file (vehicle check), or record its own motion alone"
            )
        if final:
            break
        # a trial step whose residuals are not finite is rejected by the trust region
        theta = least_squares(fit.residuals, theta, fit.jacobian, bounds=(lower, upper), x_scale="jac", max_nfev=60).x
        residual = np.concatenate([part.reshape(-1, 3) for part in fit.by_segment(theta)[0]])
        free_count = len(residual) - len(fit.edges)  # one initial value of each of u, v and r is fitted per segment
        fit.sd = np.maximum(fit.sd * np.sqrt((residual**2).sum(axis=0) / free_count), MIN_SD)
    return fit, theta


def _structure_warnings(velocity: Array, sd: Array, explained: Array) -> list[str]:
    """Return what shows that the structure of the model does not fit, from the through-water ``velocity`` (M, 3)."""
    size = np.sqrt(np.mean(velocity**2, axis=0))
    size[:2] = np.hypot(*size[:2])
    units = ("mm/s", "mm/s", "mrad/s")
    shown = [
        f"{direction} (residual {1e3 * error:.3g} {unit}, {share:.0%} of its variance)"
        for direction, error, unit, share, rms in zip(DIRECTIONS, sd, units, explained, size, strict=True)
        if share >= MAX_EXPLAINED and error > MIN_MISFIT * rms
    ]
    warnings = []
    if shown:
        warnings.append(
            f"the structure of the model does not fit {' and '.join(shown)}: forces that the model lacks explain "
            "this share in pieces of the log to which they were not fitted. The intervals are widened to contain the "
            "coefficients beside such forces"
        )
    worse = int(sd[1] > sd[0])
    ratio = float(sd[worse] / sd[1 - worse])
    if ratio > MAX_RATIO and sd[worse] > MIN_MISFIT * size[0]:
        warnings.append(
            f"the residual {DIRECTIONS[worse]} ({1e3 * sd[worse]:.3g} mm/s) is {ratio:.1f} times the one "
            f"{DIRECTIONS[1 - worse]} ({1e3 * sd[1 - worse]:.3g} mm/s): errors of the estimates are alike in both, "
            f"so the structure of the model does not fit {DIRECTIONS[worse]}, or the thrusts are not those reported"
        )
    return warnings


def _contradictions(coefficients: Sequence[IdentifiedCoefficient]) -> list[str]:
    """Return the declared coefficients that the log contradicts."""
    return [
        f"the log contradicts the declared {one.name} = {one.file:.4g} {one.unit}: its 95 % interval is "
        f"{one.low:.4g} to {one.high:.4g} {one.unit}. The declared value is kept, and the other coefficients are "
        "fitted with it; measure it again, or leave [reference_point] out of the vehicle file to let the log find it"
        for one in coefficients
        if one.declared and not one.low <= one.file <= one.high
    ]


def _at_bounds(vehicle: Vehicle, coefficients: Sequence[IdentifiedCoefficient]) -> list[str]:
    """Return the masses that would be smaller than the dry mass by the log alone."""
    return [
        f"{one.name} is at its bound, dry_mass_kg = {vehicle.dry_mass_kg:g} of the file: the reported thrusts are too "
        "small, or the dry mass is too large"
        for one in coefficients
        if one.excited and one.name.startswith("mass") and one.value <= 1.0001 * vehicle.dry_mass_kg
    ]


def _below_noise(velocity: Array, sd: Array) -> set[str]:
    """Return the degrees of freedom among surge, sway and yaw whose ``velocity`` (M, 3) is not above its errors (3,).

    There the fitted initial states would follow the errors, and coefficients would be fitted to them.
    """
    size = np.sqrt(np.mean(velocity**2, axis=0))
    names = ("surge", "sway", "yaw")
    return {name for name, rms, error in zip(names, size, sd, strict=True) if rms < MIN_SIGNAL_TO_NOISE * error}


def _fits(check: StructureCheck) -> bool:
    """Return True if forces that the model lacks explain little of each residual."""
    return bool(np.all(check.explained < MAX_EXPLAINED))


def _intervals(fit: ShootingFit, theta: Array, check: StructureCheck) -> tuple[Array, Array, Array]:
    """Return the half widths (P,) of the 95 % intervals of theta (P,), and their low and high ends."""
    half_widths = _half_widths(*fit.by_segment(theta), prior=PRIOR**-2)
    if _fits(check):
        return half_widths, theta - half_widths, theta + half_widths
    # the intervals contain the coefficients of both structures
    half_widths = np.maximum(half_widths, _quantile(len(fit.edges)) * check.sd)
    other = theta + check.shift
    return half_widths, np.minimum(theta, other) - half_widths, np.maximum(theta, other) + half_widths


def _narrow(names: Sequence[str], low: Array, high: Array) -> list[str]:
    """Return the names of the coefficients whose interval is narrow enough to count as excited."""
    half_widths = (0.5 * (high - low)).tolist()
    return [name for name, width in zip(names, half_widths, strict=False) if width <= _max_half_width(name)]


def _max_half_width(name: str) -> float:
    """Return the half width of theta up to which a coefficient counts as excited."""
    return MAX_POINT_HALF_WIDTH_M if name in REFERENCE_POINT else MAX_RELATIVE_HALF_WIDTH


def _degree_of_freedom(name: str) -> str:
    """Return the degree of freedom of a coefficient: yaw for arms and reference point, surge for thrust, or none."""
    kind, _, axis = name.partition("_")
    return {"arm": "yaw", "reference": "yaw", "thrust": "surge", "lag": ""}.get(kind, axis)


def _quantile(segments: int) -> float:
    """Return the quantile of Student's t by which a standard deviation becomes the half width of an interval."""
    return float(student.ppf(0.5 + 0.5 * CONFIDENCE, segments - 1))


def _half_widths(residuals: Sequence[Array], slopes: Sequence[Array], *, prior: float) -> Array:
    """Return the half widths (P,) of the 95 % intervals, from whitened residuals (m,) and slopes (m, P) by segment."""
    P, S = slopes[0].shape[1], len(slopes)
    information = prior * np.eye(P)
    H = sum((J.T @ J for J in slopes), information)
    g = [J.T @ r for J, r in zip(slopes, residuals, strict=True)]
    scatter = sum((np.outer(g_s, g_s) for g_s in g), np.zeros((P, P))) * S / (S - 1) + information
    covariance = inverse(H)
    variance = np.maximum(np.diag(covariance), np.diag(covariance @ scatter @ covariance))
    half_widths: Array = _quantile(S) * np.sqrt(variance)
    return half_widths


def _lags(vehicle: Vehicle, motion: Motion, delivered: Array, edges: Times) -> list[IdentifiedCoefficient]:
    """Return both lags, by least squares of commanded against delivered thrust (M, 2): F' = (u - F) / lag."""
    lags = []
    for i, name in enumerate(LAGS):
        scale = float(theta_scale(vehicle)[index_of(name)])
        command, thrust = np.ascontiguousarray(motion.command[:, i]), np.ascontiguousarray(delivered[:, i])

        def lag_residual(theta: Array, scale: float = scale, command: Array = command, thrust: Array = thrust) -> Array:
            return lagged_thrust(motion.t_s, command, thrust[0], float(theta[0]) * scale) - thrust

        best = least_squares(lag_residual, np.ones(1), bounds=(0.0, MAX_VALUE["lag"] / scale))
        sd = max(float(np.sqrt(np.mean(best.fun**2))), 1e-9)
        slope = (lag_residual(best.x + STEP) - lag_residual(best.x)) / STEP / sd
        parts = [slice(first, end) for first, end in edges]
        residuals, slopes = [best.fun[part] / sd for part in parts], [slope[part, None] for part in parts]
        half_widths = _half_widths(residuals, slopes, prior=PRIOR**-2)
        interpolation = LAG_INTERPOLATION_ERROR * float(np.median(np.diff(motion.t_s))) / scale
        half_width, theta = float(half_widths[0]) + interpolation, float(best.x[0])
        interval = theta, theta - half_width, theta + half_width
        lags.append(_coefficient(name, vehicle, interval, excited=half_width <= MAX_RELATIVE_HALF_WIDTH))
    return lags


def _coefficient(
    name: str, vehicle: Vehicle, interval: tuple[float, float, float] | None, *, excited: bool, declared: bool = False
) -> IdentifiedCoefficient:
    """Return one coefficient in the units of the file, from theta and the ends of its interval; None: not fitted.

    A coefficient that is not excited or is declared keeps the value of the file.
    """
    scale = float(theta_scale(vehicle)[index_of(name)])
    point = vehicle.reference_point
    file = float([*vehicle.coefficients(), 1.0, point.forward_m, point.starboard_m][index_of(name)])
    zero_offset = file if name in REFERENCE_POINT else 0.0  # the motion is that of the origin by the file's point
    prior_half_width = float(norm.ppf(0.5 + 0.5 * CONFIDENCE)) * PRIOR
    theta, low, high = interval or (0.0, -prior_half_width, prior_half_width)
    low, high = zero_offset + low * scale, zero_offset + high * scale
    if not (excited or declared):  # around the value of the file
        low, high = file - 0.5 * (high - low), file + 0.5 * (high - low)
    return IdentifiedCoefficient(
        name=name,
        unit=FIELDS[name][1],
        file=file,
        value=zero_offset + theta * scale if excited else file,
        low=low,
        high=high,
        excited=excited,
        declared=declared,
    )


def with_coefficients(vehicle: Vehicle, coefficients: Sequence[IdentifiedCoefficient]) -> Vehicle:
    """Return the vehicle with identified coefficients.

    Parameters
    ----------
    vehicle : vehicle with the values of the file.
    coefficients : coefficients to replace. A thrust scale multiplies the limits of both lateral thrusters.
    """
    table = msgspec.to_builtins(vehicle)
    for one in coefficients:
        if one.name == "thrust":
            for side in ("port", "starboard"):
                for key in ("min_N", "max_N", "slew_N_per_s"):
                    table["thruster"][side][key] *= one.value
        else:
            *tables, key = FIELDS[one.name][0].split(".")
            functools.reduce(operator.getitem, tables, table)[key] = one.value
    return msgspec.convert(table, Vehicle)
