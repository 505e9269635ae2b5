"""Weights from the vehicle's scales: the paper's own, and the same behaviour in any other units."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Vehicle, advance, references
from ltv_mpc.control.config import ResolvedConfig, Weights, WeightSettings
from ltv_mpc.control.horizon_selection import proposed_slowness
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.scaling import PAPER_SCALES as FOUND_FOR
from ltv_mpc.control.scaling import (
    bounded,
    characteristic_scales,
    default_weights,
    state_scale,
    time_ratio,
    weaker_couple,
)
from ltv_mpc.control.solvers import make
from ltv_mpc.errors import ConfigError

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


def test_a_vehicle_of_another_size_does_the_same_on_its_own_scale() -> None:
    """Length and mass in other units, the stage as it is: twice the size, the same plan in thrust over maximum."""
    other = scaled(PAPER, 2.0, 1.0, 8.0)
    plans = []
    for vehicle, size in ((PAPER, 1.0), (other, 2.0)):
        config = ControllerConfig(solver="daqp")
        controller = Controller(vehicle, references.Point(north_m=0.0, east_m=0.0), config)
        still = np.zeros(1)
        current = CurrentProfile(depth_m=still, north_mps=still + 0.1 * size, east_mps=still)
        start = Estimate.at_rest(north_m=0.3 * size, east_m=-0.2 * size, heading_rad=0.4)
        plans.append(controller.plan(msgspec.structs.replace(start, current=current)).thrust_N[:, :2])
    full = [62.5, other.thruster.port.max_N]
    np.testing.assert_allclose(plans[0] / full[0], plans[1] / full[1], atol=2e-3)
    assert np.abs(plans[0]).max() > 10.0


def test_a_weight_that_is_named_replaces_that_one_alone() -> None:
    surface = Vehicle.load("surface")
    config = settled(ControllerConfig(weights=WeightSettings(thrust=0.5), horizon_s=7.2), surface)
    own = default_weights(surface, slowness=proposed_slowness(surface))
    assert config.weights == msgspec.structs.replace(own, thrust=0.5)
    assert config.horizon_s == 7.2
    assert settled(config, PAPER) is config  # what is settled stays


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


def test_the_controller_uses_them_and_says_so() -> None:
    surface = Vehicle.load("surface")
    given: list[Weights] = []

    def noted(vehicle, config):
        given.append(config.weights)
        return make(vehicle, config)

    controller = Controller(surface, references.Point(north_m=0.0, east_m=0.0), make_solver=noted)
    assert isinstance(controller.config, ResolvedConfig)
    own = default_weights(surface, slowness=proposed_slowness(surface))
    assert controller.config.weights == own != Weights()
    assert given == [own.at_heading(False)]


def test_a_named_weight_outside_its_bounds_is_refused(tmp_path) -> None:
    (tmp_path / "mine.toml").write_text("[weights]\nthrust = -1.0\n")
    with pytest.raises(ConfigError, match=r"mine.toml: \[weights\] thrust = -1.0: must be >= 0 and <= 1000000"):
        ControllerConfig.load(str(tmp_path / "mine.toml"))


def test_the_weaker_side_of_a_turn_counts() -> None:
    """Starboard astern is weaker: the couple to starboard is 62.5 a1 + 15 a2."""
    lateral = PAPER.thruster
    uneven = msgspec.structs.replace(
        PAPER,
        thruster=msgspec.structs.replace(lateral, starboard=msgspec.structs.replace(lateral.starboard, min_N=-15.0)),
    )
    assert weaker_couple(uneven, uneven.coefficients()) == pytest.approx(0.2 * (62.5 + 15.0))


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_vehicle_comes_to_its_point_and_stays(name: str) -> None:
    """From 2 m off across a current of a fifth of its top speed, on its own model, with nothing set by hand."""
    vehicle = Vehicle.load(name)
    scales, still = characteristic_scales(vehicle), np.zeros(1)
    controller = Controller(
        vehicle,
        references.Point(north_m=0.0, east_m=0.0),
        ControllerConfig(horizon_s=round(1.5 * scales.time_s, 1)),
    )
    current = CurrentProfile(depth_m=still, north_mps=still, east_mps=still + 0.2 * scales.speed_mps)
    estimate = msgspec.structs.replace(Estimate.at_rest(north_m=2.0, heading_rad=1.0), current=current)
    off = []
    for _ in range(round(8.0 * scales.time_s / 0.3)):
        plan = controller.plan(estimate)
        assert plan.origin == "solved"
        estimate = advance(vehicle, estimate, plan, duration_s=0.3)
        off.append(np.hypot(estimate.north_m, estimate.east_m))
    assert max(off[-30:]) < 0.1


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
