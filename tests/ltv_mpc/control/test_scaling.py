"""Weights from the vehicle's scales: the paper's own, and the same behaviour in any other units."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import ControllerConfig, Vehicle
from ltv_mpc.control.config import Weights, WeightSettings
from ltv_mpc.control.resolution import proposed_slowness, settled
from ltv_mpc.control.scaling import PAPER_SCALES as FOUND_FOR
from ltv_mpc.control.scaling import (
    bounded,
    characteristic_scales,
    default_weights,
    state_scale,
    time_ratio,
    weaker_couple,
)
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")
SHIPPED = ("paper", "surface", "low-yaw", "weak-reverse")


def scaled(vehicle: Vehicle, length: float, time: float, mass: float) -> Vehicle:
    """Return the vehicle in other units of length, time and mass."""
    force = mass * length / time**2
    factor = {
        "dry_mass_kg": mass,
        "mass_kg": mass,
        "inertia_kgm2": mass * length**2,
        "linear_damping_kgps": mass / time,
        "quadratic_damping_kgpm": mass / length,
        "linear_damping_Nms": mass * length**2 / time,
        "quadratic_damping_kgm2": mass * length**2,
        "arm_m": length,
        "lag_s": time,
        "slew_N_per_s": force / time,
        **dict.fromkeys(("min_N", "max_N", "net_buoyancy_N", "failsafe_vertical_N"), force),
    }

    def of(table: dict) -> dict:
        return {
            k: of(v) if isinstance(v, dict) else v * factor.get(k, 1.0) if k in factor else v for k, v in table.items()
        }

    return msgspec.convert(of(msgspec.to_builtins(vehicle)), Vehicle)


def test_the_papers_vehicle_has_exactly_the_weights_that_were_found_for_it() -> None:
    assert default_weights(PAPER) == Weights()
    assert characteristic_scales(PAPER) == pytest.approx(FOUND_FOR, rel=1e-5)
    assert state_scale(PAPER).tolist() == [1.0, 1.0, 0.3, 0.3, 1.0, 0.3]
    assert time_ratio(PAPER) == 1.0


@pytest.mark.parametrize(
    ("length", "time", "mass"), [(3.0, 1.0, 1.0), (1.0, 2.5, 1.0), (1.0, 1.0, 15.0), (0.5, 0.7, 0.1)]
)
def test_scales_are_a_speed_and_a_time_whatever_the_units(length: float, time: float, mass: float) -> None:
    """Dimensional analysis: V goes as length / time, T as time, and the mass drops out."""
    of = characteristic_scales(scaled(PAPER, length, time, mass))
    assert of.speed_mps == pytest.approx(0.5 * length / time)
    assert of.time_s == pytest.approx(FOUND_FOR.time_s * time, rel=1e-5)
    speed, rounding = length / time, 6e-3  # three digits
    units = [length, length, speed, speed, 1.0, 1.0 / time]
    np.testing.assert_allclose(
        state_scale(scaled(PAPER, length, time, mass)), state_scale(PAPER) * units, rtol=rounding
    )
    assert time_ratio(scaled(PAPER, length, time, mass)) == pytest.approx(time, rel=rounding)


@pytest.mark.parametrize("name", SHIPPED)
def test_weights_of_the_target_are_bounded_by_a_common_factor(name: str) -> None:
    vehicle = Vehicle.load(name)
    own = default_weights(vehicle, slowness=proposed_slowness(vehicle))
    assert bounded(own, vehicle) is own
    given = WeightSettings(
        **{key: 300.0 * value for key, value in msgspec.structs.asdict(own).items() if key != "heading_per_rad2"}
    )
    config = settled(ControllerConfig(weights=given, horizon_s=7.2), vehicle)
    found, heading = config.weights, own.at_heading(True).heading_per_rad2
    size = state_scale(vehicle)[0] ** 2
    assert max(found.position_per_m2 * size / 2.0, found.terminal_position_per_m2 * size / 100.0) == pytest.approx(1.0)
    for key in given.__struct_fields__[:-1]:
        assert getattr(found, key) / found.thrust == pytest.approx(getattr(own, key) / own.thrust)
    assert found.at_heading(True).heading_per_rad2 / found.thrust == pytest.approx(heading / own.thrust / 300.0)
    read_back = settled(ControllerConfig(weights=WeightSettings(**msgspec.structs.asdict(found))), vehicle)
    assert read_back.weights == found


def test_the_weaker_side_of_a_turn_counts() -> None:
    """Starboard astern is weaker: the couple to starboard is 62.5 a1 + 15 a2."""
    assert weaker_couple(changed(PAPER, {"thruster.starboard.min_N": -15.0})) == pytest.approx(0.2 * (62.5 + 15.0))


@pytest.mark.parametrize("name", SHIPPED)
def test_the_cost_is_the_same_in_every_vehicles_own_length_and_time(name: str) -> None:
    """Its terms as integrals over t / T of |p / L|^2 and f: a sum over stages of h is T / h integrals, |dU| is h f'."""
    of, found = characteristic_scales(Vehicle.load(name)), characteristic_scales(PAPER)

    def terms(scales, w: Weights) -> np.ndarray:
        L, T, V, h = scales.length_m, scales.time_s, scales.speed_mps, 0.3
        return np.array(
            [
                T / h * w.position_per_m2 * L**2,
                T / h * w.thrust,
                h / T * w.thrust_change,
                w.terminal_position_per_m2 * L**2,
                w.terminal_velocity_s2_per_m2 * V**2,
            ]
        )

    ours, theirs = terms(of, default_weights(Vehicle.load(name))), terms(found, Weights())
    np.testing.assert_allclose(ours / ours[0], theirs / theirs[0], rtol=0.02)
