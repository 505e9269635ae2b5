"""Update of the disturbance observer's filter: what the change of the velocity between two estimates says of the model.

State x (12,)    b  current's bias, north and east (m/s)
                 l  lever arm, forward and starboard (m): from the vehicle's origin to the estimated point
                 q  model (8,): natural logarithms of six factors of the vehicle file (mass ahead and abeam, moment of
                    inertia, drag ahead, abeam and in yaw), added Munk mass over the mean mass, steady yaw moment over
                    the file's moment of inertia

All walk randomly. They are observed in the velocity over ground v (2,) and the yaw rate r, from one estimate to the
next (marked '), after the exact flow of the model q through the commands that were sent:

    v'  = v_o(b, q; v - r R S l) + r' R' S l + noise          S = [[0, -1], [1, 0]], so that dR/dpsi = R S
    r'  = r_o(b, q; r) + noise

v_o and r_o are those of the vehicle's origin, R and R' rotate by the headings. In the axes of the body the noise is

    a^2 + n^2                 a   error of the model, as a share of the forces that act
                              n   what is new in each estimate (``DisturbanceObserver``)

and what ``wave_filter.py`` adds: white noise of the estimates, and waves. It filters the velocity, too: a velocity that
is noisy makes the regressors of q noisy, and damping appear that is none. The update of x is iterated where an
innovation is large, since drag is quadratic: a linear correction of a large error of the current stops halfway and is
sure of it.

Source: Bar-Shalom, Li & Kirubarajan 2001, Estimation with applications to tracking and navigation, section 10.5.2.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ltv_mpc.control.prediction import Commands, Measured, Profile, current_at_depth, predict_state
from ltv_mpc.control.wave_filter import MOVING, NIS, correct_noise, predict_noise
from ltv_mpc.jit import copy_to, jit, jit_outlined
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import coefficients, rates

STATES, CURRENT, ARM, MODEL = 12, 0, 2, 4
"""Number of states, and the first of each kind."""

STEPS = (0.005, 0.005, 0.01, 0.01, 0.02, 0.02, 0.02, 0.02, 0.02, 0.02, 0.02, 0.005)
"""Steps of the finite differences, and the changes at which the iteration ends."""

MAX_LOGS = np.array([1.0, 1.0, 1.0, 1.0, 2.3, 2.3, 1.0])
"""Bounds of the logarithms and of the Munk mass: a factor of 2.7, beyond which the vehicle file is another vehicle's.
Of the drag abeam and in yaw 10: rules of thumb give a sixth of that of the catamaran in benchmarks/strangers.
"""

MAX_ITERATIONS, ITERATED_SQUARE = 5, 16.0
"""Iterations of an update whose innovation is more than its noise explains, by the normalised square. An ordinary one
is linear: iterated, the noise of a drifting vehicle, of which dh/db is zero, would be learned as a current.
"""

SURGE_ERROR, SWAY_ERROR, YAW_ERROR = 0.35, 0.15, 0.2
"""Errors of the model as shares of the forces and moments that act. An error of thrust or drag lasts for seconds: 11 %
for 3 s weighs as much as 35 % that is new in each of ten estimates.
"""

SHORT_S = 0.45
"""Interval up to which the derivatives by q are those of the acceleration; beyond it, differences of predictions."""

Newest: TypeAlias = tuple[int, float, float, float, float]
"""Time of the newest estimate (ns), its velocity over ground, north and east (m/s), heading (rad), yaw rate (rad/s)."""

Noise: TypeAlias = tuple[float, float, float, bool]
"""n^2 of velocity (m^2/s^2) and yaw rate (rad^2/s^2), the largest bias in either direction (m/s), and False if the bias
is not updated.
"""


@jit
def adapted(file: Array, model: Array) -> Array:
    """Return the coefficients (21,) of the vehicle with the learned model.

    Parameters
    ----------
    file : (21,) coefficients of the vehicle file.
    model : (8,) states q.
    """
    out = file.copy()
    out[0] *= np.exp(model[0])
    out[1] *= np.exp(model[1])
    out[3] *= np.exp(model[2])
    for i in range(3):  # linear and quadratic: ahead, abeam, yaw
        factor = np.exp(model[3 + i])
        row = i if i < 2 else 3
        out[4 + row] *= factor
        out[8 + row] *= factor
    out[19] = model[6] * 0.5 * (file[0] + file[1])
    out[20] = model[7] * file[3]
    return out


@jit
def update_belief(
    belief: tuple[Array, Array],
    newest: Newest,
    file: Array,
    measured: Measured,
    commands: Commands,
    profiles: tuple[Profile, Profile],
    noise: Noise,
    track: Array,
) -> tuple[Array, Array, float, float, float]:
    """Update the belief with the newest velocity over ground and yaw rate: the measurement update of the filter.

    Parameters
    ----------
    belief : mean (12,) and covariance (12, 12) before the update.
    newest, noise : as their types say.
    file : (21,) coefficients of the vehicle file.
    measured, commands : as ``predict_state`` takes them, from the last estimate.
    profiles : of the last and of the newest estimate, without the bias.
    track : (SIZE, 3) of ``wave_filter.py``, updated.

    Returns
    -------
    Mean (12,) and covariance (12, 12) after the update, filtered velocity over ground, north and east (m/s), and yaw
    rate (rad/s). An estimate whose numbers are not finite does not change them.
    """
    mean, P = belief
    first = CURRENT if noise[3] else ARM
    seconds = float(newest[0] - measured[0]) * 1e-9
    cos, sin = np.cos(newest[3]), np.sin(newest[3])
    at, out, Q = mean.copy(), mean.copy(), P.copy()
    H, r2, z, begin, explained = np.zeros((3, STATES)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for iteration in range(MAX_ITERATIONS):
        h, end = _predicted(at, newest, file, measured, commands, profiles)
        if iteration == 0:
            _fill_noise(end, adapted(file, at[MODEL:]), seconds, noise, r2)
            predict_noise(track, seconds, r2)
        for j in range(first, MODEL if seconds <= SHORT_S else STATES):
            shifted = at.copy()
            shifted[j] += STEPS[j]
            to, _ = _predicted(shifted, newest, file, measured, commands, profiles)
            dn, de = (to[0] - h[0]) / STEPS[j], (to[1] - h[1]) / STEPS[j]
            # In the body frame the noise of the two components is independent, so they are used one after the other.
            H[0, j], H[1, j], H[2, j] = cos * dn + sin * de, cos * de - sin * dn, (to[2] - h[2]) / STEPS[j]
        if seconds <= SHORT_S:
            _differentiate_by_model(at, file, end, seconds, H)
        dn, de = newest[1] - track[MOVING, 0] - h[0], newest[2] - track[MOVING, 1] - h[1]
        z[0], z[1], z[2] = cos * dn + sin * de, cos * de - sin * dn, newest[4] - h[2]
        if iteration == 0:
            copy_to(begin, z)
            for i in range(3):
                explained[i] = 0.0
                for j in range(STATES):
                    for k in range(STATES):
                        explained[i] += H[i, j] * P[j, k] * H[i, k]
        copy_to(out, mean)
        Q = P.copy()
        square = _correct(out, Q, H, r2, z, at)
        if iteration == 0:
            track[NIS, 0] = square
        if not np.isfinite(out.sum()):
            return mean, P, newest[1], newest[2], newest[4]
        largest = 0.0
        for j in range(STATES):
            largest = max(largest, abs(out[j] - at[j]) / STEPS[j])
        ordinary = z[0] * z[0] / r2[0] + z[1] * z[1] / r2[1] + z[2] * z[2] / r2[2] <= ITERATED_SQUARE
        copy_to(at, out)
        if largest < 1.0 or (iteration == 0 and ordinary):
            break
    for j in range(CURRENT, ARM):
        out[j] = min(max(out[j], -noise[2]), noise[2])
    correct_noise(track, seconds, r2, explained, begin, cos, sin)
    north, east = newest[1] - cos * begin[0] + sin * begin[1], newest[2] - sin * begin[0] - cos * begin[1]
    return out, Q, north, east, newest[4] - begin[2]


@jit_outlined
def _correct(x: Array, P: Array, H: Array, r2: Array, z: Array, at: Array) -> float:
    """Correct mean and covariance with the rows of H, linear about ``at``, one by one; return the sum of y^2 / S."""
    g, square = np.empty(STATES), 0.0
    for i in range(3):
        S, y = r2[i], z[i]
        for j in range(STATES):  # g = P h, and y = z - H (x - at)
            g[j] = 0.0
            for k in range(STATES):
                g[j] += P[j, k] * H[i, k]
            S += H[i, j] * g[j]
            y -= H[i, j] * (x[j] - at[j])
        square += y * y / S
        for j in range(STATES):
            x[j] += g[j] / S * y
        # P - g g' / S, symmetric to the last bit; its walks keep it positive definite
        for j in range(STATES):
            for k in range(j + 1):
                P[j, k] -= g[j] * g[k] / S
                P[k, j] = P[j, k]
    for j in range(len(MAX_LOGS)):
        x[MODEL + j] = min(max(x[MODEL + j], -MAX_LOGS[j]), MAX_LOGS[j])
    return square


@jit_outlined
def _predicted(
    state: Array,
    newest: Newest,
    file: Array,
    measured: Measured,
    commands: Commands,
    profiles: tuple[Profile, Profile],
) -> tuple[tuple[float, float, float], Array]:
    """Return velocity over ground, north and east (m/s), and yaw rate (rad/s), and the state of ``predict_state``."""
    since, estimate, report_t_ns, reported_N = measured
    (depth, north, east), later = profiles
    vehicle = adapted(file, state[MODEL:])
    origin = estimate.copy()
    arm_north, arm_east = _turning_velocity(state, estimate[2], estimate[3])
    origin[4] -= arm_north
    origin[5] -= arm_east
    end = predict_state(
        vehicle,
        (since, origin, report_t_ns, reported_N),
        newest[0],
        commands,
        (depth, north + state[0], east + state[1]),
    )
    before_north, before_east = current_at_depth(depth, north, east, end[11])
    current_north, current_east = current_at_depth(later[0], later[1], later[2], end[11])
    dn, de = current_north - before_north, current_east - before_east
    cos, sin = np.cos(end[4]), np.sin(end[4])
    p = coefficients(vehicle)
    # The change of the current with time carries the vehicle: M [u', v'] = ... - m R(psi)' c'
    u = end[2] - p.dry_mass / p.mass_surge * (cos * dn + sin * de)
    v = end[3] - p.dry_mass / p.mass_sway * (cos * de - sin * dn)
    # v = R(psi) [u, v] + c + r R S l
    arm_north, arm_east = _turning_velocity(state, newest[3], newest[4])
    over_north = cos * u - sin * v + current_north + state[0] + arm_north
    over_east = sin * u + cos * v + current_east + state[1] + arm_east
    return (over_north, over_east, end[5]), end


@jit_outlined
def _fill_noise(end: Array, vehicle: Array, seconds: float, noise: Noise, r2: Array) -> None:
    """Write a^2 + n^2 of surge, sway and yaw at a predicted state."""
    p = coefficients(vehicle)
    u, v, r, port_N, starboard_N = abs(end[2]), abs(end[3]), abs(end[5]), abs(end[6]), abs(end[7])
    surge_N = port_N + starboard_N + (p.linear_surge + p.quadratic_surge * u) * u + p.mass_sway * v * r
    sway_N = (p.linear_sway + p.quadratic_sway * v) * v + p.mass_surge * u * r
    yaw_Nm = port_N * p.arm_port + starboard_N * p.arm_starboard
    yaw_Nm += (p.linear_yaw + p.quadratic_yaw * r) * r + abs(p.mass_surge - p.mass_sway + p.added_munk) * u * v
    r2[0] = noise[0] + (SURGE_ERROR * surge_N * seconds / p.mass_surge) ** 2
    r2[1] = noise[0] + (SWAY_ERROR * sway_N * seconds / p.mass_sway) ** 2
    r2[2] = noise[1] + (YAW_ERROR * yaw_Nm * seconds / p.inertia_yaw) ** 2


@jit_outlined
def _differentiate_by_model(at: Array, file: Array, end: Array, seconds: float, H: Array) -> None:
    """Write the columns of H by q over a short interval: those of the acceleration at its end, times its length."""
    before = _accelerations(adapted(file, at[MODEL:]), end)
    for j in range(MODEL, STATES):
        model = at[MODEL:].copy()
        model[j - MODEL] += STEPS[j]
        after = _accelerations(adapted(file, model), end)
        for i in range(3):
            H[i, j] = (after[i] - before[i]) * seconds / STEPS[j]


@jit_outlined
def _accelerations(vehicle: Array, end: Array) -> Array:
    """Return u', v', r' (3,) at a predicted state, in water at rest."""
    out = np.empty(3)
    p = coefficients(vehicle)
    _, _, out[0], out[1], _, out[2] = rates(end[2], end[3], 0.0, end[5], end[6], end[7], 0.0, 0.0, 0.0, 0.0, p)
    return out


@jit
def _turning_velocity(state: Array, heading: float, yaw_rate: float) -> tuple[float, float]:
    """Return r R S l, north and east (m/s): the velocity of the estimated point relative to the origin."""
    cos, sin = np.cos(heading), np.sin(heading)
    forward, starboard = -yaw_rate * state[ARM + 1], yaw_rate * state[ARM]
    return cos * forward - sin * starboard, sin * forward + cos * starboard


@jit
def propagate(P: Array, walks: Array, prior: Array) -> Array:
    """Return the covariance after the random walks, with the largest variances bounded by the prior.

    Parameters
    ----------
    P : (12, 12) covariance before.
    walks : (12,) variances that are added.
    prior : (12,) prior variances; the same for both components of b, and of l.

    Returns
    -------
    (12, 12) covariance. Directions that are not observed do not grow beyond the prior.
    """
    out = P.copy()
    for i in range(STATES):
        out[i, i] += walks[i]
    i = 0
    while i < STATES:
        pair = 2 if i < MODEL else 1
        largest = out[i, i]
        if pair == 2:
            a, b, c = out[i, i], out[i, i + 1], out[i + 1, i + 1]
            largest = 0.5 * (a + c) + np.sqrt(0.25 * (a - c) ** 2 + b * b)
        scale = np.sqrt(prior[i] / largest) if largest > prior[i] else 1.0
        for j in range(STATES):
            for k in range(i, i + pair):
                out[k, j] *= scale
                out[j, k] *= scale
        i += pair
    return out
