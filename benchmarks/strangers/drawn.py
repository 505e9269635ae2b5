"""Hulls drawn at random, each with the file of an owner who knows it more or less.

From 4 to 600 kg, top speeds of 0.6 to 2.5 m/s, and thrusters, damping and lags that such boats have. The hull moves by
the controller's equations. In the file, masses, drag, damping in yaw, arms and lag are wrong by ``FILE_ERROR``, the
standard deviation of their logarithms. ``flight.load`` knows each hull by its name.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from ltv_mpc import Vehicle
from ltv_mpc.vehicle.parameters import Rotation, Thruster, Thrusters, Translation

NAME = "drawn "  # first part of a hull's name; the seed follows
FILE_ERROR = 0.25


def vehicles(seed: int) -> tuple[Vehicle, Vehicle]:
    """Return the vehicle as it is, and as its file says."""
    rng = np.random.default_rng([11, seed])

    def between(low: float, high: float) -> float:
        return float(math.exp(rng.uniform(math.log(low), math.log(high))))

    dry_kg, speed_mps = between(4.0, 600.0), between(0.6, 2.5)
    length_m = 0.3 + between(0.8, 1.6) * (dry_kg / 30.0) ** (1 / 3)
    surge_kg = dry_kg * between(1.03, 1.2)
    sway_kg = surge_kg * between(1.0, 2.2)
    inertia_kgm2 = sway_kg * length_m**2 / between(8.0, 14.0)
    push_N, linear = dry_kg * between(0.2, 3.0), rng.uniform(0.1, 0.9)  # of both thrusters, and share of linear drag
    aside, aside_linear = between(2.0, 12.0), between(0.3, 1.0)  # drag abeam over drag ahead
    turn_s, turn_linear = between(0.5, 4.0), rng.uniform(0.2, 0.9)  # in which a turn of 0.3 rad/s ends
    arm_m, lag_s = length_m * between(0.12, 0.35), float(rng.choice([0.0, 0.05, 0.15, 0.3, 0.6]))
    drag_kgps, drag_kgpm = push_N * linear / speed_mps, push_N * (1.0 - linear) / speed_mps**2
    thruster = Thruster(
        arm_m=arm_m,
        min_N=-0.5 * push_N * between(0.4, 1.0),
        max_N=0.5 * push_N,
        slew_N_per_s=0.5 * push_N * between(0.8, 4.0),
        lag_s=lag_s,
        propeller_diameter_m=0.08 * math.sqrt(push_N / 100.0) + 0.02,
        max_rps=80.0,
    )
    true = Vehicle(
        name=f"{NAME}{seed}",
        description="drawn at random",
        dry_mass_kg=dry_kg,
        water_density_kgpm3=1025.0,
        surge=Translation(mass_kg=surge_kg, linear_damping_kgps=drag_kgps, quadratic_damping_kgpm=drag_kgpm),
        sway=Translation(
            mass_kg=sway_kg,
            linear_damping_kgps=aside_linear * aside * drag_kgps,
            quadratic_damping_kgpm=aside * drag_kgpm,
        ),
        yaw=Rotation(
            inertia_kgm2=inertia_kgm2,
            linear_damping_Nms=inertia_kgm2 * turn_linear / turn_s,
            quadratic_damping_kgm2=inertia_kgm2 * (1.0 - turn_linear) / turn_s / 0.3,
        ),
        thruster=Thrusters(port=thruster, starboard=thruster),
    )
    mass, drag, damping, arm, lag = np.exp(FILE_ERROR * rng.standard_normal(5)).tolist()
    own = replace(thruster, arm_m=arm * arm_m, lag_s=lag * lag_s)
    surge, sway, yaw = (_scaled(of, mass, d) for of, d in ((true.surge, drag), (true.sway, drag), (true.yaw, damping)))
    changes = {"dry_mass_kg": mass * dry_kg, "thruster": Thrusters(port=own, starboard=own)}
    return true, replace(true, surge=surge, sway=sway, yaw=yaw, **changes)


def _scaled(motion: Translation | Rotation, mass: float, damping: float) -> Translation | Rotation:
    """Return a motion with its mass, the first field, and its damping times factors."""
    inertia, *rest = motion.__struct_fields__
    values = {inertia: mass * getattr(motion, inertia)}
    return replace(motion, **values, **{field: damping * getattr(motion, field) for field in rest})
