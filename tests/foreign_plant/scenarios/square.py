"""Square of 20 m at 1 m/s, from a hover with the bow into the current.

With the effort "high" and the horizon of 5 s it is followed most closely; with the defaults, which are for a third of
the thrust, the craft is up to 0.27 m beside a straight part.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.config import ControllerConfig
from tests.foreign_plant.flight import SQUARE, Figure, Flight
from tests.foreign_plant.plant import STEP_S

CORNERS = np.array([[0.0, 0.0], [0.0, 20.0], [-20.0, 20.0], [-20.0, 0.0]])
SIDE_M, SPEED_MPS = 20.0, 1.0
NEAR_M = 3.0
"""From a corner: its arc, and the turn that begins before and ends after it."""


def run() -> list[Figure]:
    """Return the distances from the outline and the duration of the lap."""
    flight = Flight(config=ControllerConfig(horizon_s=5.1, effort="high"))
    flight.command(action="arm")
    flight.fly(30.0)
    hovered = len(flight.plans)
    flight.command(action="follow", reference_toml=SQUARE.read_text())
    track = flight.fly(115.0)
    following = [plan for plan in flight.plans[hovered:] if plan.progress is not None]
    times_s = np.array([plan.t_ns[0] for plan in following]) * 1e-9
    times_s -= times_s[0]
    progress = np.array([plan.progress for plan in following])
    begin_s, end_s = times_s[progress > 0.001][0], times_s[progress >= 0.999][0]
    t_s = STEP_S * np.arange(len(track))
    lap = track[(t_s >= begin_s) & (t_s <= end_s)]
    off_m, corner_m = distance_from_outline_m(lap), _distance_from_corner_m(lap)
    missed_m = max(float(np.linalg.norm(lap - corner, axis=1).min()) for corner in CORNERS)
    return [
        Figure("distance from the outline", float(off_m.max()), 0.5, "m"),
        Figure("distance from the outline, away from corners", float(off_m[corner_m > NEAR_M].max()), 0.15, "m"),
        Figure("largest distance at which a corner is passed", missed_m, 0.6, "m"),
        Figure("duration of the lap", float(end_s - begin_s), 1.25 * 4 * SIDE_M / SPEED_MPS, "s"),
    ]


def distance_from_outline_m(track: np.ndarray) -> np.ndarray:
    """Return the distance (M,) of positions (M, 2) from the outline of the square (m)."""
    sides = zip(CORNERS, np.roll(CORNERS, -1, axis=0), strict=True)
    legs = [
        np.linalg.norm(track - a - np.clip((track - a) @ (b - a) / SIDE_M**2, 0.0, 1.0)[:, None] * (b - a), axis=1)
        for a, b in sides
    ]
    distance: np.ndarray = np.min(legs, axis=0)
    return distance


def _distance_from_corner_m(track: np.ndarray) -> np.ndarray:
    """Return the distance (M,) of positions (M, 2) from the nearest corner (m)."""
    distance: np.ndarray = np.linalg.norm(track[:, None, :] - CORNERS[None, :, :], axis=2).min(axis=1)
    return distance
