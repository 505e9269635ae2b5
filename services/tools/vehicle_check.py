"""Check of a vehicle file: performance, a suitable horizon and weights, their margins, and implausible values."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import msgspec
import numpy as np

from ltv_mpc.control.config import Bow, ControllerConfig, Effort, Weights
from ltv_mpc.control.margins import Loop, Margins
from ltv_mpc.control.resolution import kept_share, proposed_slowness, settled
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import Performance, performance
from ltv_mpc.vehicle.plausibility import warnings
from ltv_mpc.vehicle.propulsion import propulsive_power_W
from ltv_mpc.vehicle.reference_point import ReferencePoint
from services.runtime.console import figure, fold
from services.tools.mission_check import MissionCheck

MARGIN_SHARES = (0.0, 0.1, 0.2, 0.4, 0.6, 0.8)
"""Currents over the top speed whose margins are shown."""


class Check(msgspec.Struct, frozen=True, kw_only=True):
    """Result of ``vehicle check --json``."""

    name: str
    description: str
    dives: bool
    reference_point: ReferencePoint
    performance: Performance
    speed_scale_mps: float
    time_scale_s: float
    horizon_s: float  # proposed; default without [controller] horizon_s
    plan_timeout_s: float  # without a new plan the thrusters go to rest after this time
    full_power_W: float | None  # at the shafts of port and starboard, full ahead at rest; null: no torque coefficients
    bow: Bow  # which end goes first on a path; default without [controller.limits] bow
    weights: Weights  # default without [controller.weights]
    slowness: float  # of these weights: scaling.py
    margins: list[Margins]  # with these weights and this horizon: margins.py
    margins_kept_mps: dict[Effort, float | None]  # strongest current in which they suffice, at most 0.8 V; null: none
    warnings: list[str]
    mission: MissionCheck | None = None  # with --reference


def _full_power_W(vehicle: Vehicle) -> float | None:
    full = np.array([[thruster.max_N for thruster in vehicle.thrusters]])
    power = propulsive_power_W(vehicle, full, np.zeros(1), np.zeros(1))
    return None if power is None else float(power[0, :2].sum())


def check(vehicle: Vehicle) -> Check:
    """Compute performance, scales, margins and warnings of a vehicle."""
    can, scales = performance(vehicle), characteristic_scales(vehicle)
    efforts: tuple[Effort, ...] = ("low", "normal", "high")
    configs = {effort: settled(ControllerConfig(effort=effort), vehicle) for effort in efforts}
    kept = {effort: kept_share(vehicle, config) for effort, config in configs.items()}
    config = configs["normal"]
    return Check(
        name=vehicle.name,
        description=vehicle.description,
        dives=vehicle.can_dive,
        reference_point=vehicle.reference_point,
        performance=can,
        speed_scale_mps=scales.speed_mps,
        time_scale_s=scales.time_s,
        horizon_s=config.horizon_s,
        plan_timeout_s=vehicle.plan_timeout_s,
        full_power_W=_full_power_W(vehicle),
        bow=config.limits.bow or "either",
        weights=config.weights,
        slowness=proposed_slowness(vehicle),
        margins=[Loop(vehicle, config, share).margins() for share in MARGIN_SHARES],
        margins_kept_mps={effort: share * scales.speed_mps if share >= 0.0 else None for effort, share in kept.items()},
        warnings=warnings(vehicle, can),
    )


def table(of: Check) -> str:
    """Format the result as text."""
    can, w, point = of.performance, of.weights, of.reference_point
    rows = [
        ("top speed ahead", _value(can.top_speed_ahead_mps, "m/s")),
        ("top speed astern", _value(can.top_speed_astern_mps, "m/s")),
        ("turning rate to starboard", _degrees(can.turning_rate_starboard_radps)),
        ("turning rate to port", _degrees(can.turning_rate_port_radps)),
        ("turn by 90 deg, rest to rest", _value(can.turn_90deg_s, "s")),
        (
            "stops from top speed",
            f"{_value(can.stopping_distance_m, 'm')} in {_value(can.stopping_time_s, 's')}, full astern",
        ),
        ("time constant of surge", _value(can.surge_s, "s")),
        ("time constant of sway", f"{_value(can.sway_s, 's')} from a tenth of top speed"),
        ("time constant of yaw", _value(can.yaw_s, "s")),
        ("time constant of a thruster", f"{_value(can.thruster_s, 's')}, slew and lag"),
        (
            "estimates are of the point",
            f"{point.forward_m:g} m forward, {point.starboard_m:g} m starboard, {point.down_m:g} m down of the origin",
        ),
        ("power, full ahead at rest", _value(of.full_power_W, "W", none="no torque coefficients")),
        ("without a new plan", f"thrusters at rest after {of.plan_timeout_s:g} s"),
        ("proposed horizon", f"{of.horizon_s:g} s, the default of every controller"),
        ("on a path", "bow first: it is weaker astern" if of.bow == "first" else "bow or stern first"),
        ("scales of the weights", f"V {of.speed_scale_mps:.3g} m/s, T {of.time_scale_s:.3g} s"),
        ("weights", f"position {w.position_per_m2:g} /m2, at the end {w.terminal_position_per_m2:g} /m2"),
        ("", f"velocity at the end {w.terminal_velocity_s2_per_m2:g} s2/m2"),
        ("", f"thrust {w.thrust:g}, its change {w.thrust_change:g}"),
        *_margin_rows(of),
    ]
    kind = "dives" if of.dives else "surface craft"
    lines = [fold(f"{of.name} ({kind}): {of.description}")]
    lines += [fold(f"  {name:<34}{value}", indent=36) for name, value in rows]
    lines += [fold(f"  warning: {warning}") for warning in of.warnings] or ["  no warnings"]
    return "\n".join(lines)


def _margin_rows(of: Check) -> Iterator[tuple[str, str]]:
    """Yield the rows of the margins."""
    normal, low, high = (_kept(of.margins_kept_mps[effort]) for effort in ("normal", "low", "high"))
    beyond = "" if normal == _kept(of.margins[-1].current_mps) else "; what to do beyond: docs/robustness.md"
    yield "margins suffice in a current", f"{normal} ({low} with effort low, {high} with effort high){beyond}"
    for m in of.margins:
        found = f"gain +{m.gain_up_db:.1f} / -{m.gain_down_db:.1f} dB, dead time {m.dead_time_s:.2f} s"
        yield f"margins in {m.current_mps:.3g} m/s", f"{found}, lag {m.lag_s:.2f} s"
    if not of.margins[-1].aside_controllable:
        yield "", "ahead and in heading only: to the side this hull reacts at second order, so fly it to see"


_value = partial(figure, digits=".3g", none="none")


def _kept(mps: float | None) -> str:
    return "in none" if mps is None else f"up to {mps:.3g} m/s"


def _degrees(rate: float | None) -> str:
    return "none: no steady turn" if rate is None else f"{math.degrees(abs(rate)):.3g} deg/s"
