"""Plausibility checks of a vehicle file across several fields: mostly wrong units.

Each check compares two quantities of one vehicle. Its limits are wide: a warning means a factor of ten or more from
vehicles of 30 kg to 3 t, or a vehicle that cannot fulfil its purpose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import msgspec

from ltv_mpc.vehicle.parameters import Thruster, Translation, Vehicle
from ltv_mpc.vehicle.performance import Performance, fastest_drag_rate_per_s
from ltv_mpc.vehicle.propulsion import thrust

MIN_MASS_KG, MAX_MASS_KG = 5.0, 50_000.0
ACCELERATION_MPS2 = (0.005, 10.0)
MIN_TOP_SPEED_MPS, MAX_TOP_SPEED_MPS = 0.05, 15.0
TOTAL_OVER_DRY = (0.95, 4.0)
"""Ratio of total mass (with added mass) to dry mass; added mass is positive and rarely above a few times dry mass."""

GYRATION_OVER_SIZE = (0.15, 10.0)
"""Ratio of sqrt(I_z / M_y) to the edge of a cube of the hull's volume: 1 for a hull of 1 : 7."""

GYRATION_OVER_LENGTH = (0.21, 0.6)
"""The same over the hull's length: 0.29 for a rod, and 0.19 for one whose masses are in pounds."""

MAX_TIP_MPS = 60.0
"""Largest speed of the tips of a propeller: beyond half of it water cavitates."""
MAX_PROPELLER_OVER_SIZE = 1.2
MAX_PROPELLER_OVER_THRUST = 3.0
"""Largest thrust of a propeller at the top speed over ``max_N``: a kgf is 9.8 N, a lbf 4.4 N."""

ARM_OVER_SIZE = (0.02, 5.0)
ARM_OVER_BEAM = 0.75
"""Largest arm over the hull's beam, which thrusters at the sides hardly exceed; in feet it is 3.3 times as many."""
REFERENCE_POINT_OVER_SIZE = 5.0
ASTERN_OVER_AHEAD, TABLE_OVER_THRUST = (0.15, 3.0), (0.9, 8.0)
"""Ratios of ``min_N``, and of the end of ``pwm_N``, to ``max_N``: a kgf is 9.8 N, a lbf 4.4 N."""
MIN_THRUSTER_TIME_S = 0.02
MAX_THRUSTER_TIME_S = 5.0
MAX_DRAG_RATE_PER_S = 10.0
"""Fastest decay that Runge-Kutta steps of 0.15 s resolve within a few per cent; from 18 / s they are unstable."""

MAX_TURN_S = 60.0


def warnings(vehicle: Vehicle, can: Performance) -> list[str]:
    """Return one sentence for each implausible value.

    Parameters
    ----------
    vehicle : parameters of the vehicle.
    can : its performance.
    """
    return [
        *_size_warnings(vehicle),
        *_reference_point_warnings(vehicle),
        *_lateral_thruster_warnings(vehicle),
        *_damping_warnings(vehicle),
        *_motion_warnings(vehicle, can),
        *_heave_warnings(vehicle),
    ]


def _size_warnings(vehicle: Vehicle) -> Iterator[str]:
    mass, size = vehicle.dry_mass_kg, _size(vehicle)
    if not MIN_MASS_KG <= mass <= MAX_MASS_KG:
        yield f"dry_mass_kg = {mass:g}: {MIN_MASS_KG:g} to {MAX_MASS_KG:g} kg are usual; is it in g or t?"
    low, high = TOTAL_OVER_DRY
    for name in ("surge", "sway", "heave"):
        table: Translation | None = getattr(vehicle, name)
        if table is not None and not low <= table.mass_kg / mass <= high:
            ratio = f"{table.mass_kg / mass:.3g} x dry_mass_kg"
            yield f"[{name}] mass_kg = {table.mass_kg:g}: {ratio}; must be dry mass plus added mass, in kg"
    gyration = math.sqrt(vehicle.yaw.inertia_kgm2 / vehicle.sway.mass_kg)
    low, high = (size * bound for bound in GYRATION_OVER_SIZE)
    if not low <= gyration <= high:
        yield (
            f"[yaw] inertia_kgm2 = {vehicle.yaw.inertia_kgm2:g}: a radius of gyration of {gyration:.2g} m does not fit "
            f"{mass:g} kg, of which {low:.2g} to {high:.2g} m are usual"
        )
    elif vehicle.hull is not None:
        if (beam_m := vehicle.hull.beam_m) > vehicle.hull.length_m:
            yield f"[hull] beam_m = {beam_m:g}: wider than length_m = {vehicle.hull.length_m:g}; is it in m?"
        low, high = (vehicle.hull.length_m * bound for bound in GYRATION_OVER_LENGTH)
        if not low <= gyration <= high:
            yield (
                f"[yaw] inertia_kgm2 = {vehicle.yaw.inertia_kgm2:g} on [sway] mass_kg = {vehicle.sway.mass_kg:g}: a "
                f"radius of gyration of {gyration:.2g} m; a hull of {vehicle.hull.length_m:g} m has {low:.2g} to "
                f"{high:.2g} m: are the masses in kg (not in pounds), and is the inertia in kg m2?"
            )


def _reference_point_warnings(vehicle: Vehicle) -> Iterator[str]:
    point, high = vehicle.reference_point, REFERENCE_POINT_OVER_SIZE * _size(vehicle)
    for name, offset in msgspec.structs.asdict(point).items():
        if abs(offset) > high:
            fits = f"within {high:.2g} m of the centre fits {vehicle.dry_mass_kg:g} kg"
            yield f"[reference_point] {name} = {offset:g}: {fits}; is it in m?"


def _lateral_thruster_warnings(vehicle: Vehicle) -> Iterator[str]:
    size = _size(vehicle)
    for name, thruster in (("port", vehicle.thruster.port), ("starboard", vehicle.thruster.starboard)):
        low, high = (size * bound for bound in ARM_OVER_SIZE)
        high = high if vehicle.hull is None else min(high, ARM_OVER_BEAM * vehicle.hull.beam_m)
        if thruster.arm_m == 0.0:
            yield f"[thruster.{name}] arm_m = 0: this thruster makes no yaw moment, only the other one steers"
        elif not low <= thruster.arm_m <= high:
            fits = f"{low:.2g} to {high:.2g} m fit {vehicle.dry_mass_kg:g} kg{' and the beam' if vehicle.hull else ''}"
            yield f"[thruster.{name}] arm_m = {thruster.arm_m:g}: {fits}; is it in m?"
        if thruster.min_N == 0.0:
            yield f"[thruster.{name}] min_N = 0: no thrust astern, so the vehicle cannot brake"
        yield from _thruster_warnings(f"[thruster.{name}]", thruster)
    push, mass = vehicle.pushes_N[0], vehicle.surge.mass_kg
    low, high = ACCELERATION_MPS2
    if not low <= push / mass <= high:
        usual = f"{low:g} to {high:g} are usual; is the thrust in kN or gf, or the mass in g or t?"
        yield f"[thruster] {push:g} N on {mass:g} kg is {push / mass:.2g} m/s2: {usual}"


def _thruster_warnings(where: str, thruster: Thruster) -> Iterator[str]:
    for name, force_N, (low, high) in (
        ("min_N", abs(thruster.min_N), ASTERN_OVER_AHEAD),
        ("pwm_N", max(thruster.pwm_N, default=0.0), TABLE_OVER_THRUST),
    ):
        if force_N and not low <= force_N / thruster.max_N <= high:
            usual = f"{low:g} to {high:g} times as much is usual; are both in N (not in kgf, lbf or gf)?"
            yield f"{where} {name} of {force_N:g} and max_N = {thruster.max_N:g}: {usual}"
    full_s = thruster.max_N / thruster.slew_N_per_s + thruster.lag_s
    field = f"{where} lag_s = {thruster.lag_s:g}, slew_N_per_s = {thruster.slew_N_per_s:g}"
    if full_s < MIN_THRUSTER_TIME_S:
        yield f"{field}: full thrust in {1e3 * full_s:.2g} ms; 0.1 to 1 s are usual"
    if full_s > MAX_THRUSTER_TIME_S:
        yield f"{field}: full thrust after {full_s:.2g} s; is the lag in ms, or the slew per minute?"


def _damping_warnings(vehicle: Vehicle) -> Iterator[str]:
    p = vehicle.coefficients()
    for name, damping, means in (
        ("surge", p.linear_surge + p.quadratic_surge, "there is no top speed"),
        ("sway", p.linear_sway + p.quadratic_sway, "a sideways drift never ends"),
        ("heave", p.linear_heave + p.quadratic_heave, "the sinking speed has no limit"),
        ("yaw", p.linear_yaw + p.quadratic_yaw, "a turn never ends"),
    ):
        if damping == 0.0 and getattr(vehicle, name) is not None:
            yield f"[{name}] both dampings are 0: {means}"


def _motion_warnings(vehicle: Vehicle, can: Performance) -> Iterator[str]:
    top = can.top_speed_ahead_mps
    if top is not None and not MIN_TOP_SPEED_MPS <= top <= MAX_TOP_SPEED_MPS:
        usual = f"{MIN_TOP_SPEED_MPS:g} to {MAX_TOP_SPEED_MPS:g} are usual"
        yield f"top speed ahead {top:.3g} m/s: {usual}; is thrust in N, damping in kg/s and kg/m?"
    if top is not None and top <= MAX_TOP_SPEED_MPS:
        yield from _propeller_warnings(vehicle, top)
    if can.turn_90deg_s is not None and can.turn_90deg_s > MAX_TURN_S:
        yield f"a turn by 90 deg takes {can.turn_90deg_s:.0f} s: is arm_m in m and inertia_kgm2 in kg m2?"
    fastest = fastest_drag_rate_per_s(vehicle)
    if fastest > MAX_DRAG_RATE_PER_S:
        least = f"stages of 0.3 s resolve at least {1.0 / MAX_DRAG_RATE_PER_S:g} s"
        yield f"drag changes the motion within {1.0 / fastest:.2g} s: {least}"


def _propeller_warnings(vehicle: Vehicle, top: float) -> Iterator[str]:
    largest_m = MAX_PROPELLER_OVER_SIZE * _size(vehicle)
    names = ("port", "starboard", "vertical")[: 3 if vehicle.can_dive else 2]
    for name, thruster, inflow in zip(names, vehicle.thrusters, (top, top, 0.0), strict=False):
        where, diameter_m, rps = f"[thruster.{name}]", thruster.propeller_diameter_m, thruster.max_rps
        tips_mps = math.pi * diameter_m * rps
        gives = thrust(rps, inflow, vehicle.water_density_kgpm3, diameter_m)
        at = f"the top speed of {top:.3g} m/s" if inflow else "rest"
        at_top = f"at {at} a propeller of {diameter_m:g} m gives {max(gives, 0.0):.3g} N"
        if diameter_m > largest_m:
            fits = f"at most {largest_m:.2g} m fits {vehicle.dry_mass_kg:g} kg"
            yield f"{where} propeller_diameter_m = {diameter_m:g}: {fits}; is it in m?"
        elif tips_mps > MAX_TIP_MPS:
            tips = f"the tips of a propeller of {diameter_m:g} m move at {tips_mps:.0f} m/s"
            yield f"{where} max_rps = {rps:g}: {tips}; is it in rev/min?"
        elif gives < 0.95 * thruster.max_N:
            yield f"{where} max_rps = {rps:g}: {at_top}, max_N = {thruster.max_N:g}"
        elif gives > MAX_PROPELLER_OVER_THRUST * thruster.max_N:
            yield f"{where} max_N = {thruster.max_N:g}: {at_top}; is the thrust in N (not in kgf or lbf)?"


def _heave_warnings(vehicle: Vehicle) -> Iterator[str]:
    if not vehicle.can_dive:
        return
    vertical, up = vehicle.thrusters[2], vehicle.net_buoyancy_N
    yield from _thruster_warnings("[thruster.vertical]", vertical)
    if up > vertical.max_N:
        yield f"net_buoyancy_N = {up:g}: above the vertical thruster's max_N = {vertical.max_N:g}, cannot dive"
    if up < vertical.min_N:
        yield f"net_buoyancy_N = {up:g}: below the vertical thruster's min_N = {vertical.min_N:g}, cannot rise"
    if vehicle.failsafe_vertical_N > up:
        more = f"failsafe_vertical_N = {vehicle.failsafe_vertical_N:g}: more than net_buoyancy_N = {up:g}"
        yield f"{more}: without a plan the vehicle sinks"


def _size(vehicle: Vehicle) -> float:
    """Return the edge (m) of a cube of the hull's volume."""
    return float((vehicle.dry_mass_kg / vehicle.water_density_kgpm3) ** (1.0 / 3.0))
