"""Masses, damping, thrust scale, arms and lags of a vehicle from how it moved: nonlinear least squares by shooting.

The run is cut into pieces of some seconds. From an unknown start y_s = [u, v, r] each piece follows the model's own
exact flow under the commands that were sent, and is held against the estimates y_k of u, v (through the water) and r:

    min over theta, y_s of   sum_k | (y_k - flow_k(y_s, theta)) / sd |^2 + sum_i ((theta_i - 1) / PRIOR)^2

theta_i is a coefficient over the value that the file has (or over a size that fits where the file has 0), so the second
term says that the file is right to 100 % of itself: it rules where the run says nothing. y_s are eliminated piece by
piece (variable projection: Golub & Pereyra 1973), theta is found by scipy's trust region with damping, lags and masses
not negative; sd, one for each of u, v and r, is scaled to the residuals found.

The interval of theta_i is that of Student's t with the larger of two variances: of white errors, H^-1, and of errors
that are correlated within a piece but not from piece to piece, H^-1 (sum_s g_s g_s') H^-1 (Liang & Zeger 1986). Errors
that last for the whole run, as a wrong water profile, are in neither.

What no motion tells: multiply all masses, dampings and thrusts by one factor and the motion is the same, and for yaw
alike inertia, damping and both arms. So one of mass and thrust is taken from the file (``known``: thrust, unless said),
and one of inertia and arms (the arms, which a ruler measures).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Times
from ltv_mpc.vehicle.flow import STATES, advance_stage, lag_weights
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from ltv_mpc.vehicle.resistance import UNBRAKED_MPS, UNBRAKED_RADPS, steady_speed

Known: TypeAlias = Literal["thrust", "mass"]
KnownYaw: TypeAlias = Literal["arm", "inertia"]

PIECE_S = 6.0
GAP_S = 1.0
"""Estimates further apart than this do not belong to one piece."""

LEAST_PIECES = 5
PRIOR = 1.0
EXCITED = 0.5
"""The half width of an interval, over the value in the file, from which on the run is not said to have told it."""

INTERPOLATION = 0.02
"""Of the time between two reports: what a lag is off by because commands bend between them (a hundredth was seen)."""

LOUD = 2.0
"""Root mean square of a velocity over the standard deviation of its errors, from which on it is motion."""

CONFIDENCE = 0.95
STEP = 1e-4
"""Of a coefficient, relative, and of a start, in m/s and rad/s: differences that slopes are taken over."""

SMALLEST = 0.05
"""Of a mass or of the thrust scale, over the value in the file."""

NAMES = (
    "mass_surge", "mass_sway", "inertia_yaw",
    "linear_surge", "quadratic_surge", "linear_sway", "quadratic_sway", "linear_yaw", "quadratic_yaw",
    "arm_port", "arm_starboard", "lag_port", "lag_starboard", "thrust",
)  # fmt: skip
"""All that can be fitted; ``thrust`` is the factor on what is commanded."""

LAGS = ("lag_port", "lag_starboard")
BOUNDED = ("mass_surge", "mass_sway", "inertia_yaw", "thrust")


class Motion(NamedTuple):
    """How a vehicle moved and what it was told, at M instants."""

    t_s: Array  # (M,) increasing
    velocity: Array  # (M, 3) u, v through the water (m/s, FRD), yaw rate r (rad/s)
    heading: Array  # (M,) rad
    shear: Array  # (M, 2) the water's rate along the path, dc/dz w, north and east (m/s2)
    command: Array  # (M, 2) port and starboard thrust commanded (N), linear in between
    sd: Array  # (3,) of the errors of velocity
    thrust: Array | None = None  # (M, 2) delivered, as the actuators report it (N); None where they do not


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """One coefficient: in the file, found, and within which it lies at 95 %. ``thrust`` is a factor."""

    name: str
    unit: str
    file: float
    value: float
    low: float
    high: float
    excited: bool  # else the run does not tell it, and ``value`` is what file and run together say of it


class Identified(NamedTuple):
    """What a run says of a vehicle."""

    found: list[Found]
    sd: Array  # (3,) of the residuals of u, v (m/s) and r (rad/s)
    pieces: int
    seconds: float


class NotEnoughMotion(ValueError):
    """A run too short to tell anything."""


class _Fit:
    """The least-squares problem of one motion."""

    def __init__(self, vehicle: Vehicle, motion: Motion, free: Sequence[str]) -> None:
        self.free = tuple(free)
        self.nominal = np.array([*vehicle.coefficients(), 1.0])
        self.unit = units_of(vehicle)
        self.motion = motion
        self._input = motion.command if motion.thrust is None else motion.thrust
        if motion.thrust is not None:  # what is delivered has its lag behind it
            self.nominal[[_place(name) for name in LAGS]] = 0.0
        self.edges = pieces(motion.t_s)
        self._counts = self.edges[:, 1] - self.edges[:, 0]
        self.sd = motion.sd.copy()
        self._places = [_place(name) for name in self.free]
        self._start = motion.velocity[self.edges[:, 0]].copy()

    @property
    def origin(self) -> Array:
        """theta of the file (P,): 1, or 0 where it has 0."""
        return self.nominal[self._places] / self.unit[self._places]

    @property
    def lower(self) -> Array:
        """Least theta (P,)."""
        return np.array([SMALLEST if name in BOUNDED else 0.0 for name in self.free])

    def residuals(self, theta: Array) -> Array:
        """(3 M' + P,): of the motion from the best starts, and of the prior."""
        r, _ = self._reduced(theta, slopes=False)
        return np.concatenate([r.ravel(), (theta - self.origin) / PRIOR])

    def slopes(self, theta: Array) -> Array:
        """d residuals / d theta (3 M' + P, P)."""
        _, J = self._reduced(theta, slopes=True)
        return np.concatenate([J.reshape(-1, len(theta)), np.eye(len(theta)) / PRIOR])

    def by_piece(self, theta: Array) -> tuple[list[Array], list[Array]]:
        """Residuals and slopes of each piece, starts eliminated: (3 m,) and (3 m, P) each."""
        r, J = self._reduced(theta, slopes=True)
        ends = np.cumsum(self._counts)[:-1]
        return [one.ravel() for one in np.split(r, ends)], [one.reshape(-1, len(theta)) for one in np.split(J, ends)]

    def _reduced(self, theta: Array, *, slopes: bool) -> tuple[Array, Array]:
        """Whitened residuals (M', 3) and slopes (M', 3, P) without what the starts can take up."""
        for _ in range(2):  # in its starts the problem is nearly linear
            r = self._shoot(theta, self._start)
            Jy = np.stack([(self._shoot(theta, self._start + d) - r) / STEP for d in STEP * np.eye(3)], axis=-1)
            self._start = self._start - self._taken(Jy, r[..., None])[:, :, 0]
        r = self._shoot(theta, self._start)
        r = r - self._within(Jy, r[..., None])[..., 0]
        if not slopes:
            return r, np.empty((*r.shape, 0))
        base = self._shoot(theta, self._start)
        J = np.empty((*r.shape, len(theta)))
        for i in range(len(theta)):
            ahead = theta.copy()
            ahead[i] += STEP
            J[..., i] = (self._shoot(ahead, self._start) - base) / STEP
        return r, J - self._within(Jy, J)

    def _taken(self, Jy: Array, what: Array) -> Array:
        """(S, 3, K): the change of each start that fits ``what`` (M', 3, K) best."""
        # normal equations of each piece; its first instant is its start itself, so they are regular
        first = np.concatenate([[0], np.cumsum(self._counts)[:-1]])
        left = np.add.reduceat(np.einsum("mcx,mcy->mxy", Jy, Jy), first)
        return np.linalg.solve(left, np.add.reduceat(np.einsum("mcy,mck->myk", Jy, what), first))

    def _within(self, Jy: Array, what: Array) -> Array:
        """The part of ``what`` (M', 3, K) that the starts can take up."""
        taken: Array = np.repeat(self._taken(Jy, what), self._counts, axis=0)
        part: Array = np.einsum("mcy,myk->mck", Jy, taken)
        return part

    def _shoot(self, theta: Array, start: Array) -> Array:
        """Whitened residuals (M', 3) of every piece from its start (S, 3)."""
        values = self.nominal.copy()
        values[self._places] = theta * self.unit[self._places]
        # The water's acceleration acts on the dry mass: that grows with the total mass in surge.
        values[DRY] = self.nominal[DRY] * values[0] / self.nominal[0]
        m = self.motion
        off = np.empty((int(self._counts.sum()), 3))
        _shoot(
            Coefficients(*values[:-1]),
            values[-1],
            m.t_s,
            m.velocity,
            m.heading,
            m.shear,
            self._input,
            self.edges,
            start,
            off,
        )
        return off / self.sd


DRY = Coefficients._fields.index("dry_mass")


@jit
def lagging(t: Array, command: Array, start: float, lag: float) -> Array:
    """Thrust delivered (M,) from ``start``, where the command (M,) at times t (M,) is linear in between."""
    F = np.empty(len(t))
    F[0] = start
    for k in range(len(t) - 1):
        a, b0, b1 = lag_weights(t[k + 1] - t[k], t[k + 1] - t[k], lag)
        F[k + 1] = a * F[k] + b0 * command[k] + b1 * command[k + 1]
    return F


@jit
def _shoot(
    p: Coefficients,
    scale: float,
    t: Array,
    velocity: Array,
    heading: Array,
    shear: Array,
    command: Array,
    edges: Times,
    start: Array,
    off: Array,
) -> None:
    """``off`` (M', 3): the model from each start less what was estimated, piece after piece.

    ``scale`` on what is commanded; ``edges`` (S, 2): first instant of each piece, and its end.
    """
    F = np.empty(command.shape)
    for i in range(2):
        F[:, i] = lagging(t, scale * command[:, i], scale * command[0, i], p.lag_port if i == 0 else p.lag_starboard)
    X, out = np.zeros(STATES), np.empty(STATES)
    c0, c1 = np.zeros(2), np.zeros(2)
    row = 0
    for s in range(len(edges)):
        X[2], X[3], X[5] = start[s, 0], start[s, 1], start[s, 2]
        for k in range(edges[s, 0], edges[s, 1]):
            off[row, 0], off[row, 1], off[row, 2] = X[2] - velocity[k, 0], X[3] - velocity[k, 1], X[5] - velocity[k, 2]
            row += 1
            if k + 1 < edges[s, 1]:
                h = t[k + 1] - t[k]
                X[4], X[6], X[7] = heading[k], F[k, 0], F[k, 1]
                c1[0], c1[1] = h * shear[k, 0], h * shear[k, 1]
                advance_stage(X, scale * command[k], scale * command[k + 1], c0, c1, h, p, out)
                X[:] = out


def identify(vehicle: Vehicle, motion: Motion, known: Known = "thrust", known_yaw: KnownYaw = "arm") -> Identified:
    """The vehicle's coefficients from a motion. Raises ``NotEnoughMotion`` where there are fewer than five pieces."""
    held = {"thrust"} if known == "thrust" else {"mass_surge"}
    held |= {"arm_port", "arm_starboard"} if known_yaw == "arm" else {"inertia_yaw"}
    held |= set() if motion.thrust is None else set(LAGS)
    free = [name for name in NAMES if name not in held]
    fit, theta = _solved(vehicle, motion, free)
    quiet = [name for name in free if _belongs(name) in _quiet(motion, fit.sd)]
    if quiet:
        fit, theta = _solved(vehicle, motion, [name for name in free if name not in quiet])
    half = _half_widths(*fit.by_piece(theta), prior=1.0 / PRIOR**2)
    found = [result(name, vehicle, float(theta[i]), float(half[i])) for i, name in enumerate(fit.free)]
    for name in quiet:
        origin = float(fit.nominal[_place(name)] / fit.unit[_place(name)])
        found.append(result(name, vehicle, origin, float(student.ppf(0.5 + 0.5 * CONFIDENCE, 1e6)) * PRIOR))
    if motion.thrust is not None:
        found += lags(vehicle, motion, fit.edges)
    return Identified(
        found,
        fit.sd,
        len(fit.edges),
        float(motion.t_s[-1] - motion.t_s[0]),
    )


def _solved(vehicle: Vehicle, motion: Motion, free: Sequence[str]) -> tuple[_Fit, Array]:
    """The fit of the coefficients ``free``, with errors as large as the residuals are, and its theta (P,)."""
    fit = _Fit(vehicle, motion, free)
    if len(fit.edges) < LEAST_PIECES:
        raise NotEnoughMotion(f"{len(fit.edges)} pieces of {PIECE_S:g} s: at least {LEAST_PIECES} are needed")
    theta = np.maximum(fit.origin, fit.lower + 1e-6)
    for _ in range(2):
        theta = least_squares(
            fit.residuals, theta, fit.slopes, bounds=(fit.lower, np.inf), x_scale="jac", max_nfev=60
        ).x
        residual = np.concatenate([one.reshape(-1, 3) for one in fit.by_piece(theta)[0]])
        free_count = len(residual) - len(fit.edges)  # one start of each of u, v and r is fitted in each piece
        fit.sd = fit.sd * np.sqrt((residual**2).sum(axis=0) / free_count)
    return fit, theta


def _quiet(motion: Motion, sd: Array) -> set[str]:
    """Of surge, sway and yaw those whose velocity does not stand out of its errors ``sd`` (3,).

    There the starts that are fitted to errors would pass for motion, and coefficients be found in them.
    """
    size = np.sqrt(np.mean(motion.velocity**2, axis=0))
    return {name for name, rms, error in zip(("surge", "sway", "yaw"), size, sd, strict=True) if rms < LOUD * error}


def _belongs(name: str) -> str:
    """The degree of freedom that a coefficient is seen in: of arms yaw, of the thrust scale surge, of lags none."""
    kind, _, of = name.partition("_")
    return {"arm": "yaw", "thrust": "surge", "lag": ""}.get(kind, of)


def _half_widths(residuals: Sequence[Array], slopes: Sequence[Array], *, prior: float) -> Array:
    """Of the 95 % interval of each theta (P,), from whitened residuals (m,) and slopes (m, P) of each piece."""
    P, S = slopes[0].shape[1], len(slopes)
    belief = prior * np.eye(P)
    H = sum((J.T @ J for J in slopes), belief)
    g = [J.T @ r for J, r in zip(slopes, residuals, strict=True)]
    scatter = sum((np.outer(one, one) for one in g), np.zeros((P, P))) * S / (S - 1) + belief
    inverse = np.linalg.inv(H)
    variance = np.maximum(np.diag(inverse), np.diag(inverse @ scatter @ inverse))
    return np.asarray(student.ppf(0.5 + 0.5 * CONFIDENCE, S - 1) * np.sqrt(variance))


def lags(vehicle: Vehicle, motion: Motion, edges: Times) -> list[Found]:
    """Both lags from what was commanded and what was delivered: F' = (u - F) / lag."""
    assert motion.thrust is not None
    every = []
    for i, name in enumerate(LAGS):
        unit = float(units_of(vehicle)[_place(name)])
        command, thrust = np.ascontiguousarray(motion.command[:, i]), np.ascontiguousarray(motion.thrust[:, i])

        def off(theta: Array, unit: float = unit, command: Array = command, thrust: Array = thrust) -> Array:
            return lagging(motion.t_s, command, thrust[0], float(theta[0]) * unit) - thrust

        best = least_squares(off, np.ones(1), bounds=(0.0, np.inf))
        sd = max(float(np.sqrt(np.mean(best.fun**2))), 1e-9)
        slope = (off(best.x + STEP) - off(best.x)) / STEP / sd
        parts = [slice(first, end) for first, end in edges]
        half = _half_widths([best.fun[p] / sd for p in parts], [slope[p, None] for p in parts], prior=1.0 / PRIOR**2)
        between = INTERPOLATION * float(np.median(np.diff(motion.t_s))) / unit
        every.append(result(name, vehicle, float(best.x[0]), float(half[0]) + between))
    return every


def result(name: str, vehicle: Vehicle, theta: float, half: float) -> Found:
    """One coefficient in the file's units, from theta and the half width of its interval."""
    unit = float(units_of(vehicle)[_place(name)])
    return Found(
        name=name,
        unit=_unit(name),
        file=float([*vehicle.coefficients(), 1.0][_place(name)]),
        value=theta * unit,
        low=(theta - half) * unit,
        high=(theta + half) * unit,
        excited=half <= EXCITED,
    )


def _unit(name: str) -> str:
    if name == "inertia_yaw":
        return "kg m2"
    if name in ("linear_yaw", "quadratic_yaw"):
        return "N m s" if name == "linear_yaw" else "kg m2"
    kinds = {"mass": "kg", "linear": "kg/s", "quadratic": "kg/m", "arm": "m", "lag": "s", "thrust": ""}
    return kinds[name.partition("_")[0]]


def _place(name: str) -> int:
    """In the array of coefficients and, last, the thrust scale."""
    return len(Coefficients._fields) if name == "thrust" else Coefficients._fields.index(name)


def units_of(vehicle: Vehicle) -> Array:
    """What theta = 1 means (20,): the file's value; where that is 0, what would matter as much at full thrust."""
    p = vehicle.coefficients()
    port, starboard = vehicle.thrusters[:2]
    push = port.max_N + starboard.max_N
    couple = port.max_N * p.arm_port + starboard.max_N * p.arm_starboard
    speed = min(steady_speed(push, p.linear_surge, p.quadratic_surge), UNBRAKED_MPS)
    rate = min(steady_speed(couple, p.linear_yaw, p.quadratic_yaw), UNBRAKED_RADPS)
    spare = {
        "linear_surge": p.quadratic_surge * speed,
        "quadratic_surge": p.linear_surge / speed,
        "linear_sway": p.quadratic_sway * speed,
        "quadratic_sway": p.linear_sway / speed,
        "linear_yaw": p.quadratic_yaw * rate,
        "quadratic_yaw": p.linear_yaw / rate,
        "lag_port": 0.2,
        "lag_starboard": 0.2,
        "arm_port": p.arm_starboard,
        "arm_starboard": p.arm_port,
    }
    values = np.array([*p, 1.0])
    for name, instead in spare.items():
        if values[_place(name)] == 0.0:
            values[_place(name)] = max(instead, 1e-6)
    return values


def pieces(t_s: Array) -> Times:
    """First instant and end (S, 2) of pieces of ``PIECE_S`` between gaps, none shorter than half of that."""
    breaks = np.flatnonzero(np.diff(t_s) > GAP_S) + 1
    edges: list[tuple[int, int]] = []
    for first, end in zip([0, *breaks], [*breaks, len(t_s)], strict=True):
        at = int(first)
        while at < end:
            to = min(int(np.searchsorted(t_s, t_s[at] + PIECE_S, side="right")), int(end))
            if t_s[to - 1] - t_s[at] >= 0.5 * PIECE_S:
                edges.append((at, to))
            at = to
    return np.array(edges, dtype=np.int64).reshape(-1, 2)


KEYS = {"mass": "mass_kg", "linear": "linear_damping_kgps", "quadratic": "quadratic_damping_kgpm"}
YAW_KEYS = {"inertia": "inertia_kgm2", "linear": "linear_damping_Nms", "quadratic": "quadratic_damping_kgm2"}
"""Of a vehicle file's tables, by the first word of a coefficient."""


def improved(vehicle: Vehicle, found: Sequence[Found]) -> Vehicle:
    """The vehicle with what was found. A thrust scale goes into the limits of both lateral thrusters."""
    table = msgspec.to_builtins(vehicle)
    for one in found:
        kind, _, of = one.name.partition("_")
        lateral = table["thruster"]
        if one.name == "thrust":
            for name in ("port", "starboard"):
                for key in ("min_N", "max_N", "slew_N_per_s"):
                    lateral[name][key] *= one.value
        elif kind in ("arm", "lag"):
            lateral[of][f"{kind}_{'m' if kind == 'arm' else 's'}"] = one.value
        else:
            table[of][(YAW_KEYS if of == "yaw" else KEYS)[kind]] = one.value
    return msgspec.convert(table, Vehicle)
