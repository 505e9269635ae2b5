"""Structure check of an identification: does the model have all forces that act on the vehicle?

Forces and moments that the model does not have are added to the fit, to first order:

    r + J dtheta + E phi,   phi ~ (0, SHARE_OF_THRUST)     E: response of the residuals r to a force of full thrust

E has terms in u, v, r and the thrusts for each direction: constant, lift of fins, coupling of sway and yaw, cubic drag,
thrust lost with speed or astern. dtheta and phi are fitted to four fifths of the segments. Where phi makes the
residuals of the other fifth smaller, a force acts that the model does not have; errors of the estimates cannot be
predicted in this way. The coefficients that such forces imply are theta + dtheta.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.shooting_fit import CURRENT_SD_MPS, PRIOR, Motion, ShootingFit, through_the_water

FOLDS = 5
SHARE_OF_THRUST = 0.1
"""Standard deviation of the prior of each additional force: its root mean square over the full thrust."""

MAX_EXPLAINED = 0.1
"""Share of the variance of the residuals from which additional forces count as present in a direction."""


class StructureCheck(NamedTuple):
    """Result of the structure check of one fit."""

    explained: Array  # (3,) share of the variance of the residuals ahead, abeam, in yaw that additional forces explain
    shift: Array  # (P,) change of theta if forces are added in the directions in which they count as present
    sd: Array  # (P,) standard deviation of theta beside these forces


def check_structure(vehicle: Vehicle, motion: Motion, fit: ShootingFit, theta: Array) -> StructureCheck:
    """Return how well forces that the model does not have explain the residuals of a fit.

    Parameters
    ----------
    vehicle : vehicle with the values of the file.
    motion : recorded motion.
    fit : fit of the motion, with ``sd`` scaled to the residuals.
    theta : (P,) best coefficients and current.
    """
    residuals, slopes = fit.by_segment(theta)
    forces, directions = _additional_forces(vehicle, motion, CURRENT_SD_MPS * theta[-2:])
    E = fit.response(theta, forces)
    ends = np.cumsum([len(part) // 3 for part in residuals])[:-1]
    slopes = [np.hstack([J, e.reshape(len(J), -1)]) for J, e in zip(slopes, np.split(E, ends), strict=True)]
    P, K = len(theta), len(forces)
    prior = np.diag(np.concatenate([np.full(P, PRIOR**-2), np.full(K, SHARE_OF_THRUST**-2)]))
    pull = np.concatenate([(theta - fit.origin) / PRIOR**2, np.zeros(K)])
    segments = range(len(slopes))
    H = np.array([A.T @ A for A in slopes])
    g = np.array([A.T @ r for A, r in zip(slopes, residuals, strict=True)])
    squares = np.zeros((2, 3))
    for fold in range(FOLDS):
        others = [s for s in segments if s % FOLDS != fold]
        information, gradient = prior + H[others].sum(axis=0), pull + g[others].sum(axis=0)
        for row, count in enumerate((P, P + K)):
            change = -inverse(information[:count, :count]) @ gradient[:count]
            for s in segments[fold::FOLDS]:
                squares[row] += ((residuals[s] + slopes[s][:, :count] @ change).reshape(-1, 3) ** 2).sum(axis=0)
    explained = 1.0 - squares[1] / np.maximum(squares[0], 1e-12)
    fitted = [*range(P), *(P + k for k, direction in enumerate(directions) if explained[direction] >= MAX_EXPLAINED)]
    covariance = inverse((prior + H.sum(axis=0))[np.ix_(fitted, fitted)])
    shift = -covariance @ (pull + g.sum(axis=0))[fitted]
    return StructureCheck(explained, shift[:P], np.sqrt(np.maximum(np.diag(covariance), 0.0))[:P])


def inverse(information: Array) -> Array:
    """Return the inverse of an information matrix (P, P) of coefficients of any size; of its singular part zero."""
    scale = 1.0 / np.sqrt(np.diag(information))
    scaled = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-13, hermitian=True)
    covariance: Array = np.outer(scale, scale) * scaled
    return covariance


def _additional_forces(vehicle: Vehicle, motion: Motion, current_mps: Array) -> tuple[list[Array], list[int]]:
    """Return K forces (M, 3), ahead and abeam (N) and moment (N m), of full thrust each, and the direction of each."""
    u, v, r = through_the_water(motion, current_mps).T
    F1, F2 = (motion.command if motion.thrust is None else motion.thrust).T
    one = np.ones(len(u))
    ahead = [one, u * u, u**3, v * v, v * r, r * r, abs(F1) + abs(F2), u * (abs(F1) + abs(F2))]
    abeam = [one, u * v, abs(u) * v, u * r, abs(u) * r, r, r * abs(r), v * abs(r), r * abs(v), v**3]
    turning = [one, u * v, abs(u) * v, u * r, abs(u) * r, v, v * abs(v), v * abs(r), r * abs(v), r**3]
    turning += [F1 + F2, abs(F1) - abs(F2)]
    port, starboard = vehicle.thrusters[:2]
    push = vehicle.pushes_N[0]
    couple = port.max_N * port.arm_m + starboard.max_N * starboard.arm_m
    forces, directions = [], []
    for direction, (size, terms) in enumerate(((push, ahead), (push, abeam), (couple, turning))):
        for term in terms:
            rms = float(np.sqrt(np.mean(term**2)))
            if rms > 1e-9:
                forces.append(np.outer(size / rms * term, np.eye(3)[direction]))
                directions.append(direction)
    return forces, directions
