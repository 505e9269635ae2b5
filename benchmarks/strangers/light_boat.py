"""Clearpath Heron: a boat of 28 kg with two hulls, whose drag couples surge, sway and yaw.

Size, mass       1.35 m, 0.98 m, 28 kg, 1.7 m/s: Clearpath Robotics, Heron USV data sheet (3.3 knots)
Thrust           35 N at most, lag 0.05 s: the simulation of the maker (github.com/heron/heron_simulator and
                 heron_description, as ported by A. Richard, Georgia Tech, "HeronHydroSettings")
Drag, linear     16.4 kg/s ahead, 15.8 kg/s across, 6 N m s: the same
Drag, quadratic  17.3 kg/m ahead and 17.3 kg m2 in yaw: identified with a boat of 35 kg (the same group, "quadratic SID"
                 of its Kingfisher task); the linear drag ahead is then 0, and that of yaw 5.8 N m s
Inertia          8.06 kg m2 with all that moves with it: the same identification
Added mass       0.1 and 1.5 of the mass, without the Munk moment in yaw: Fossen's twin hull (catamaran.py)

This hull's own, so that the drag is not diagonal: each hull has a half of the drag ahead, at 0.37 m to each side, but
the starboard one a tenth more, as with a sounder under it; and the drag across acts 0.12 m astern of the centre of
gravity, where the jets are.
"""

from __future__ import annotations

import numpy as np

from benchmarks.strangers.rigid_body import Hull

MASS_KG, INERTIA_KGM2 = 28.0, 8.06
AHEAD_KGPM, ACROSS_KGPS, TURN_NMS, TURN_KGM2 = 17.3, 15.8, 5.8, 17.3
HULL_AT_M, SOUNDER, ASTERN_M = 0.37, 0.1, -0.12
THRUST_N, LAG_S = 35.0, 0.05
AFLOAT = (2000.0, 60.0, 80.0)  # stiffness of heave, roll and pitch, N/m and N m: 2.2 rad/s and above


def hull() -> Hull:
    """Return the hull. Heave, roll and pitch are not excited."""
    D = np.diag([0.0, ACROSS_KGPS, 100.0, 13.0, 13.0, TURN_NMS])
    D[1, 5] = D[5, 1] = ACROSS_KGPS * ASTERN_M
    D[5, 5] += ACROSS_KGPS * ASTERN_M**2
    half = 0.5 * AHEAD_KGPM
    return Hull(
        name="light_boat",
        M=np.diag([1.1 * MASS_KG, 2.5 * MASS_KG, 2.0 * MASS_KG, 3.0, 5.0, INERTIA_KGM2]),
        D=D,
        quadratic=np.array([0.0, 0.0, 0.0, 0.0, 0.0, TURN_KGM2]),
        cancelled_munk_kg=1.4 * MASS_KG,
        along=np.array([[-HULL_AT_M, half], [HULL_AT_M, (1.0 + SOUNDER) * half]]),
        G=np.diag(AFLOAT),
        centre_of_gravity=(0.0, 0.0, 0.0),
        max_N=THRUST_N,
        min_N=-THRUST_N,
        arms_m=(HULL_AT_M, HULL_AT_M),
        lag_s=LAG_S,
    )
