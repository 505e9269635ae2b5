"""Maritime Robotics Otter with a payload of 25 kg: a catamaran of 80 kg with linear drag, six degrees of freedom.

The numbers are those of T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd edition 2021,
chapters 3, 4 and 6, and of the model "otter" that accompanies it (Marine Systems Simulator, and the Python Vehicle
Simulator, github.com/cybergalactic): masses, radii of gyration, added mass, metacentric heights, damping by time
constants and relative damping, propellers. Its model leaves the Munk moment in yaw out and has quadratic damping in yaw
alone. The sway has the linear damping of the Marine Systems Simulator, a time constant of 1 s, without cross-flow drag.

The centre of gravity lies 0.14 m ahead of the middle between the propellers' stations.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.strangers.rigid_body import Hull, rigid_body_inertia

G, RHO = 9.81, 1025.0
HULL_KG, PAYLOAD_KG = 55.0, 25.0
HULL_AT, PAYLOAD_AT = np.array([0.2, 0.0, -0.2]), np.array([0.0, 0.0, -0.35])  # m
LENGTH_M, BEAM_M, PONTOON_M, PONTOON_AT_M = 2.0, 1.08, 0.25, 0.395
WATERLINE, BLOCK = 0.75, 0.4  # coefficients of a pontoon
FLOTATION_AT_M = -0.2
AHEAD_N, ASTERN_N = 0.5 * 24.4 * G, 0.5 * 13.6 * G  # one propeller, bollard pull
TOP_MPS = 6 * 0.5144
PROPELLER_S = 0.32


def hull() -> Hull:
    """Return the hull."""
    mass = HULL_KG + PAYLOAD_KG
    gravity = (HULL_KG * HULL_AT + PAYLOAD_KG * PAYLOAD_AT) / mass
    gyration = HULL_KG * np.diag([0.4 * BEAM_M, 0.25 * LENGTH_M, 0.25 * LENGTH_M]) ** 2
    inertia = gyration - sum(
        part * np.cross(np.eye(3), at) @ np.cross(np.eye(3), at)
        for part, at in ((HULL_KG, HULL_AT - gravity), (PAYLOAD_KG, PAYLOAD_AT - gravity))
    )
    added = np.diag([0.1 * HULL_KG, 1.5 * HULL_KG, HULL_KG, *(np.array([0.2, 0.8, 1.7]) * np.diag(inertia))])
    M = rigid_body_inertia(mass, tuple(gravity), inertia) + added

    volume = mass / RHO
    draught = volume / (2 * BLOCK * PONTOON_M * LENGTH_M)
    area = WATERLINE * LENGTH_M * PONTOON_M
    across = 2 * LENGTH_M * PONTOON_M**3 / 12 * 6 * WATERLINE**3 / ((1 + WATERLINE) * (1 + 2 * WATERLINE))
    across += 2 * area * PONTOON_AT_M**2
    lengthwise = 0.8 * 2 * PONTOON_M * LENGTH_M**3 / 12
    keel_to_buoyancy = (5 * draught / 2 - 0.5 * volume / (LENGTH_M * PONTOON_M)) / 3
    keel_to_gravity = draught - gravity[2]
    heights = [keel_to_buoyancy + second / volume - keel_to_gravity for second in (across, lengthwise)]
    heave, roll, pitch = 2 * RHO * G * area, mass * G * heights[0], mass * G * heights[1]
    # the spring of heave acts at the centre of flotation
    stiffness = np.array(
        [
            [heave, 0.0, -heave * FLOTATION_AT_M],
            [0.0, roll, 0.0],
            [-heave * FLOTATION_AT_M, 0.0, pitch + heave * FLOTATION_AT_M**2],
        ]
    )
    surge = 2 * AHEAD_N / TOP_MPS
    vertical = [
        2 * relative * math.sqrt(spring * M[i, i])
        for relative, spring, i in ((0.3, heave, 2), (0.2, roll, 3), (0.4, pitch, 4))
    ]
    return Hull(
        name="catamaran",
        M=M,
        D=np.diag([surge, M[1, 1], *vertical, M[5, 5]]),  # time constants of 1 s in sway and yaw
        quadratic=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 10.0 * M[5, 5]]),
        cancelled_munk_kg=1.5 * HULL_KG - 0.1 * HULL_KG,
        G=stiffness,
        centre_of_gravity=tuple(gravity),
        max_N=AHEAD_N,
        min_N=-ASTERN_N,
        arms_m=(PONTOON_AT_M, PONTOON_AT_M),
        lag_s=PROPELLER_S,
    )
