"""Prolate ellipsoid of 70 kg with fins and two thrusters at the stern: a hull that the Munk moment turns broadside.

Added mass       Lamb's k-factors: H. Lamb, Hydrodynamics, 6th edition 1932, articles 114 and 115; Imlay 1961;
                 Fossen 2021, section 8.4.2. A spheroid of 1.8 m and 0.27 m displaces 70.5 kg of sea water.
Drag ahead       C_d 0.42 by the frontal area: B. Allen, W. S. Vorus and T. Prestero, Propulsion system performance
                 enhancements on REMUS AUVs, OCEANS 2000
Drag at rest     time constants of 20 s in surge, sway and heave and 5 s in yaw, relative damping 0.3 in roll and 0.8 in
                 pitch: the model "remus100" of Fossen 2021
Cross-flow       C_d 1.1 of each slice, and fins with a lift slope of 3.12 by an area of 6.65e-3 m2 each, 0.638 m
                 astern: T. Prestero, Verification of a six-degree of freedom simulation model for the REMUS AUV, MIT
                 2001; area and place are scaled from his hull of 1.33 m to this one
Trim             neutral; centre of gravity 2 cm below that of buoyancy (remus100)
Thrusters        SeaBotix BTD150 (data sheet: 2.2 kgf continuous, both ways); the share that speed takes away is that of
                 the propeller of remus100, K_T = 0.4566 - 0.4174 J at a wake of 0.944, with a diameter of 76 mm

The arms of the thrusters are this hull's own: 0.2 m, on the ends of the fins. The fins are fixed.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.strangers.rigid_body import Hull, rigid_body_inertia
from ltv_mpc.messages import Triple

RHO, G = 1026.0, 9.81
LENGTH_M, DIAMETER_M = 1.8, 0.27
BELOW_M = 0.02
FRONTAL_DRAG, CROSS_DRAG = 0.42, 1.1
SCALE = LENGTH_M / 1.33
FIN_SLOPE, FIN_M2, FIN_AT_M = 3.12, 6.65e-3 * SCALE**2, -0.638 * SCALE
TRANSLATION_S, YAW_S = 20.0, 5.0
THRUST_N, PROPELLER_M, ARM_M, LAG_S = 2.2 * G, 0.0762, 0.2, 0.2
SLICES = 12


def lamb(aspect: float) -> Triple:
    """Return Lamb's k-factors of a prolate spheroid: added mass along and across, added inertia across the length.

    Parameters
    ----------
    aspect : length over diameter, above 1.
    """
    e2 = 1.0 - 1.0 / aspect**2
    e = math.sqrt(e2)
    logarithm = math.log((1 + e) / (1 - e))
    alpha = 2 * (1 - e2) / e**3 * (0.5 * logarithm - e)
    beta = 1 / e2 - (1 - e2) / (2 * e**3) * logarithm
    turning = e2**2 * (beta - alpha) / ((2 - e2) * (2 * e2 - (2 - e2) * (beta - alpha)))
    return alpha / (2 - alpha), beta / (2 - beta), turning


def hull() -> Hull:
    """Return the hull."""
    a, b = LENGTH_M / 2, DIAMETER_M / 2
    mass = 4 / 3 * math.pi * RHO * a * b**2
    across = mass * (a**2 + b**2) / 5
    inertia = np.diag([2 / 5 * mass * b**2, across, across])
    k1, k2, k_turning = lamb(a / b)
    gravity = (0.0, 0.0, BELOW_M)
    added = mass * np.diag([k1, k2, k2, 0.0, 0.0, 0.0])
    added[3:, 3:] = np.diag([0.3 * inertia[0, 0], k_turning * across, k_turning * across])
    M = rigid_body_inertia(mass, gravity, inertia) + added
    righting = mass * G * BELOW_M
    roll, pitch = (2 * relative * math.sqrt(righting * M[i, i]) for relative, i in ((0.3, 3), (0.8, 4)))
    frontal = 0.5 * RHO * FRONTAL_DRAG * math.pi * b**2
    edges = np.linspace(-a, a, SLICES + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    # the slice's area seen from the side, by the mean of the local diameter
    diameter = DIAMETER_M * np.sqrt(1 - (middle / a) ** 2)
    slices = np.stack([middle, 0.5 * RHO * CROSS_DRAG * diameter * np.diff(edges)], axis=1)
    full_rps = math.sqrt(THRUST_N / (RHO * PROPELLER_M**4 * 0.4566))
    return Hull(
        name="ellipsoid",
        M=M,
        D=np.diag([*(M[i, i] / TRANSLATION_S for i in range(3)), roll, pitch, M[5, 5] / YAW_S]),
        quadratic=np.array([frontal, 0.0, 0.0, 0.0, 0.0, 0.0]),
        across=slices,
        fin_kgpm=0.5 * RHO * FIN_SLOPE * 2 * FIN_M2,
        fin_m=FIN_AT_M,
        G=np.diag([0.0, righting, righting]),
        centre_of_gravity=gravity,
        max_N=THRUST_N,
        min_N=-THRUST_N,
        arms_m=(ARM_M, ARM_M),
        lag_s=LAG_S,
        lost=0.4174 / 0.4566 * 0.944 / (full_rps * PROPELLER_M),
    )
