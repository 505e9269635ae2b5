"""What looks wrong in a vehicle file that no bound of a single field can see: mostly units.

Each test compares two things that the file says of one vehicle. Its limits are wide: a warning means a factor of ten
or more from what vehicles of 30 kg to 3 t have, or a vehicle that cannot do what it is for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from ltv_mpc.vehicle.parameters import Thruster, Translation, Vehicle
from ltv_mpc.vehicle.performance import Performance, quickest_rate_per_s
from ltv_mpc.vehicle.thruster import thrust

LIGHTEST_KG, HEAVIEST_KG = 5.0, 50_000.0
ACCELERATION_MPS2 = (0.005, 10.0)
SLOWEST_MPS, FASTEST_MPS = 0.05, 15.0
TOTAL_OVER_DRY = (0.95, 10.0)
"""Mass with added mass over dry mass: added mass is not negative, and seldom more than a few times the hull's own."""

GYRATION_OVER_SIZE = (0.15, 10.0)
"""sqrt(I_z / M_y) over the edge of a cube of the hull's volume: 1 for a hull of 1 : 7."""

ARM_OVER_SIZE = (0.02, 5.0)
QUICKEST_THRUSTER_S = 0.02
SLOWEST_THRUSTER_S = 5.0
QUICKEST_MOTION_PER_S = 10.0
"""Runge-Kutta steps of 0.15 s are off by some per cent of such a decay, and no longer stable from 18 / s on."""

LONGEST_TURN_S = 60.0


def doubts(vehicle: Vehicle, can: Performance) -> list[str]:
    """One sentence for each thing that looks wrong; ``can`` is what the vehicle can do."""
    return [
        *_of_size(vehicle),
        *_of_lateral(vehicle),
        *_of_damping(vehicle),
        *_of_motion(vehicle, can),
        *_of_heave(vehicle),
    ]


def _of_size(vehicle: Vehicle) -> Iterator[str]:
    mass, size = vehicle.dry_mass_kg, _size(vehicle)
    if not LIGHTEST_KG <= mass <= HEAVIEST_KG:
        yield f"dry_mass_kg = {mass:g}: {LIGHTEST_KG:g} to {HEAVIEST_KG:g} kg are usual; is it in g or t?"
    low, high = TOTAL_OVER_DRY
    for name in ("surge", "sway", "heave"):
        table: Translation | None = getattr(vehicle, name)
        if table is not None and not low <= table.mass_kg / mass <= high:
            ratio = f"{table.mass_kg / mass:.3g} x dry_mass_kg"
            yield f"[{name}] mass_kg = {table.mass_kg:g}: {ratio}; it is the dry mass and the added mass, in kg"
    gyration = math.sqrt(vehicle.yaw.inertia_kgm2 / vehicle.sway.mass_kg)
    low, high = (size * bound for bound in GYRATION_OVER_SIZE)
    if not low <= gyration <= high:
        yield (
            f"[yaw] inertia_kgm2 = {vehicle.yaw.inertia_kgm2:g}: a radius of gyration of {gyration:.2g} m does not fit "
            f"{mass:g} kg, of which {low:.2g} to {high:.2g} m are usual"
        )


def _of_lateral(vehicle: Vehicle) -> Iterator[str]:
    size = _size(vehicle)
    for name, thruster in (("port", vehicle.thruster.port), ("starboard", vehicle.thruster.starboard)):
        low, high = (size * bound for bound in ARM_OVER_SIZE)
        if thruster.arm_m == 0.0:
            yield f"[thruster.{name}] arm_m = 0: this thruster turns nothing, the other one alone steers"
        elif not low <= thruster.arm_m <= high:
            fits = f"{low:.2g} to {high:.2g} m fit {vehicle.dry_mass_kg:g} kg"
            yield f"[thruster.{name}] arm_m = {thruster.arm_m:g}: {fits}; is it in m?"
        if thruster.min_N == 0.0:
            yield f"[thruster.{name}] min_N = 0: it cannot push astern, so it cannot brake"
        yield from _of_thruster(f"[thruster.{name}]", thruster)
    push = vehicle.thruster.port.max_N + vehicle.thruster.starboard.max_N
    low, high = ACCELERATION_MPS2
    if not low <= push / vehicle.surge.mass_kg <= high:
        yield (
            f"[thruster] {push:g} N on {vehicle.surge.mass_kg:g} kg is {push / vehicle.surge.mass_kg:.2g} m/s2: "
            f"{low:g} to {high:g} are usual; is the thrust in kN or gf, or the mass in g or t?"
        )


def _of_thruster(where: str, thruster: Thruster) -> Iterator[str]:
    full = thruster.max_N / thruster.slew_N_per_s
    if full + thruster.lag_s < QUICKEST_THRUSTER_S:
        yield (
            f"{where} lag_s = {thruster.lag_s:g}, slew_N_per_s = {thruster.slew_N_per_s:g}: full thrust in "
            f"{1e3 * (full + thruster.lag_s):.2g} ms; 0.1 to 1 s are usual"
        )
    if full + thruster.lag_s > SLOWEST_THRUSTER_S:
        yield (
            f"{where} lag_s = {thruster.lag_s:g}, slew_N_per_s = {thruster.slew_N_per_s:g}: full thrust after "
            f"{full + thruster.lag_s:.2g} s; is the lag in ms, or the slew per minute?"
        )


def _of_damping(vehicle: Vehicle) -> Iterator[str]:
    for name, means in (
        ("surge", "nothing brakes it, there is no top speed"),
        ("sway", "a drift sideways lasts for ever"),
        ("heave", "nothing brakes a descent"),
    ):
        table: Translation | None = getattr(vehicle, name)
        if table is not None and table.linear_damping_kgps + table.quadratic_damping_kgpm == 0.0:
            yield f"[{name}] both dampings are 0: {means}"
    if vehicle.yaw.linear_damping_Nms + vehicle.yaw.quadratic_damping_kgm2 == 0.0:
        yield "[yaw] both dampings are 0: a turn lasts for ever"


def _of_motion(vehicle: Vehicle, can: Performance) -> Iterator[str]:
    top = can.top_speed_ahead_mps
    if top is not None and not SLOWEST_MPS <= top <= FASTEST_MPS:
        usual = f"{SLOWEST_MPS:g} to {FASTEST_MPS:g} are usual"
        yield f"top speed ahead {top:.3g} m/s: {usual}; is thrust in N, damping in kg/s and kg/m?"
    if top is not None and top <= FASTEST_MPS:
        yield from _of_propellers(vehicle, top)
    if can.turn_90deg_s is not None and can.turn_90deg_s > LONGEST_TURN_S:
        yield f"a turn by 90 deg takes {can.turn_90deg_s:.0f} s: is arm_m in m and inertia_kgm2 in kg m2?"
    quickest = quickest_rate_per_s(vehicle)
    if quickest > QUICKEST_MOTION_PER_S:
        yield (
            f"drag changes the motion within {1.0 / quickest:.2g} s: stages of 0.3 s do not resolve less than "
            f"{1.0 / QUICKEST_MOTION_PER_S:g} s"
        )


def _of_propellers(vehicle: Vehicle, top: float) -> Iterator[str]:
    for name, one in (("port", vehicle.thruster.port), ("starboard", vehicle.thruster.starboard)):
        gives = thrust(one.max_rps, top, vehicle.water_density_kgpm3, one.propeller_diameter_m)
        if gives < 0.95 * one.max_N:
            yield (
                f"[thruster.{name}] max_rps = {one.max_rps:g}: at the top speed of {top:.3g} m/s a propeller of "
                f"{one.propeller_diameter_m:g} m gives {max(gives, 0.0):.3g} N, max_N = {one.max_N:g}"
            )


def _of_heave(vehicle: Vehicle) -> Iterator[str]:
    if not vehicle.dives:
        return
    vertical, up = vehicle.thrusters[2], vehicle.net_buoyancy_N
    yield from _of_thruster("[thruster.vertical]", vertical)
    if up > vertical.max_N:
        yield f"net_buoyancy_N = {up:g}: more than the vertical thruster's max_N = {vertical.max_N:g}, it cannot dive"
    if up < vertical.min_N:
        yield f"net_buoyancy_N = {up:g}: below the vertical thruster's min_N = {vertical.min_N:g}, it cannot rise"
    if vehicle.failsafe_vertical_N > up:
        yield (
            f"failsafe_vertical_N = {vehicle.failsafe_vertical_N:g}: more than net_buoyancy_N = {up:g}: "
            "without a plan the vehicle sinks"
        )


def _size(vehicle: Vehicle) -> float:
    """Edge (m) of a cube of the hull's volume."""
    return float((vehicle.dry_mass_kg / vehicle.water_density_kgpm3) ** (1.0 / 3.0))
