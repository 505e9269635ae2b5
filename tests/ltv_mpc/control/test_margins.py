"""The loop that a horizon closes: poles and margins are the controller's own, and those of the defaults suffice.

The oracle is the controller itself, with its observer and its prediction, on a plant that is integrated here.
"""

from __future__ import annotations

import copy
from functools import cache

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Vehicle, references
from ltv_mpc.control.config import Disturbance, ResolvedConfig, WeightSettings
from ltv_mpc.control.lateral import RESTING_MPS
from ltv_mpc.control.margins import Change, Loop, Margins, steady_state
from ltv_mpc.control.resolution import kept_share, proposed_slowness, settled
from ltv_mpc.control.scaling import characteristic_scales, default_weights
from ltv_mpc.vehicle.parameters import Translation
from services.tools import vehicle_check
from tests.ltv_mpc.estimates import moving, water
from tests.ltv_mpc.reports import report
from tests.ltv_mpc.vehicles import changed

BOAT = Vehicle.load("bluerobotics-boat")
_SURGE = BOAT.surge
LIGHT = msgspec.structs.replace(
    BOAT,
    sway=Translation(
        mass_kg=0.68 * _SURGE.mass_kg,
        linear_damping_kgps=0.24 * _SURGE.linear_damping_kgps,
        quadratic_damping_kgpm=1.5 * _SURGE.quadratic_damping_kgpm,
    ),
)
"""Quick to turn, slow to stop drifting to the side."""
SHARE = 0.35
STRONG = 0.2
"""Current of the flights, over the top speed."""
CYCLE_NS = 300_000_000


def is_stable(vehicle: Vehicle, config: ResolvedConfig) -> bool:
    """Return True if no pole grows in a weak or a strong current."""
    return all(Loop(vehicle, config, share).keeps() for share in (0.1, 0.2, SHARE, 0.5))


def test_the_proposal_is_stable_with_the_weights_in_use():
    """A controller with less weight on thrust needs a longer horizon."""
    usual, eager = settled(ControllerConfig(), LIGHT), WeightSettings(thrust=1e-3)
    proposed = settled(ControllerConfig(weights=eager), LIGHT)
    assert proposed.horizon_s > usual.horizon_s
    assert is_stable(LIGHT, proposed)
    assert not is_stable(LIGHT, settled(ControllerConfig(weights=eager, horizon_s=usual.horizon_s), LIGHT))


@pytest.mark.parametrize("name", ["paper", "surface", "low-yaw", "weak-reverse", "bluerobotics-boat"])
def test_of_the_shipped_vehicles_all_are_stable_and_keep_their_margins_in_a_current(name):
    vehicle = Vehicle.load(name)
    config = settled(ControllerConfig(), vehicle)
    assert is_stable(vehicle, config)
    assert kept_share(vehicle, config) >= (0.05 if name == "bluerobotics-boat" else 0.4)


def flown(
    vehicle: Vehicle, config: ControllerConfig, share: float, change: Change, *, off_m: float, cycles: int
) -> np.ndarray:
    """Position (M, 2) off the point, north and east (m), at each cycle; at first ``off_m``, bow-on in a known current.

    The plant is integrated in steps of 10 ms. Its thrust departs from the steady one by ``gain_db`` times what the
    command a dead time before does, through the lag. Plans begin 50 ms after the estimate, and the reports are what the
    vehicle file makes of the commands.
    """
    p, h = vehicle.coefficients(), 0.01
    X, C = steady_state(p, share * characteristic_scales(vehicle).speed_mps)
    profile = water(*C)
    controller = Controller(vehicle, references.Point(north_m=0.0, east_m=0.0), config)
    n, e, u, v, psi, r = off_m, off_m, *X[2:6]
    thrust, believed, late = X[6:].copy(), X[6:].copy(), round(change.dead_time_s / h)
    sent = [X[6:]] * (late + 1)
    knots, plan, track = np.zeros(1), sent[0][None], []
    lags = np.array([p.lag_port, p.lag_starboard])
    follow, believe = -np.expm1(-h / (lags + change.lag_s)), -np.expm1(-h / lags)
    pending = None
    for k in range(30 * cycles):
        if k % 30 == 0:
            track.append((n, e))
            north = np.cos(psi) * u - np.sin(psi) * v + C[0]
            east = np.sin(psi) * u + np.cos(psi) * v + C[1]
            sinks = {"velocity_down_mps": 2.0 * RESTING_MPS}  # or it would rest within a millimetre of its point
            there = {"north_m": n, "east_m": e, "heading_rad": psi, "yaw_rate_radps": r}
            estimate = moving((north, east), t_ns=k * 10_000_000, current=profile, **there, **sinks)
            applied = report(k * 10_000_000, [*believed, 0.0], [*sent[-1], 0.0])
            pending = controller.plan(estimate, t_ns=k * 10_000_000, applied=applied)
            assert pending.origin == "solved"
        if k % 30 == 5 and pending is not None:
            knots, plan = pending.t_ns * 1e-9, pending.thrust_N[:, :2]
        sent.append(np.array([np.interp((k + 1) * h, knots, plan[:, i]) for i in range(2)]))
        believed = believed + believe * (sent[-1] - believed)
        thrust = thrust + follow * (X[6:] + 10.0 ** (change.gain_db / 20.0) * (sent[-1 - late] - X[6:]) - thrust)
        du = thrust.sum() - (p.linear_surge + p.quadratic_surge * abs(u)) * u + p.mass_sway * v * r
        dv = -(p.linear_sway + p.quadratic_sway * abs(v)) * v - p.mass_surge * u * r
        dr = thrust @ [p.arm_port, -p.arm_starboard] - (p.linear_yaw + p.quadratic_yaw * abs(r)) * r
        dr += (p.mass_surge - p.mass_sway) * u * v
        u, v, r = u + h * du / p.mass_surge, v + h * dv / p.mass_sway, r + h * dr / p.inertia_yaw
        psi += h * r
        n += h * (np.cos(psi) * u - np.sin(psi) * v + C[0])
        e += h * (np.sin(psi) * u + np.cos(psi) * v + C[1])
    return np.array(track)


OBSERVING = ControllerConfig(disturbance=Disturbance(sd_mps=0.15, max_mps=3.0, lever_arm_sd_m=0.0, model_sd=0.0))


@cache
def strong_current() -> tuple[ResolvedConfig, Loop, Margins]:
    """Return the settings of the flights, their loop and its margins."""
    config = settled(OBSERVING, BOAT)
    loop = Loop(BOAT, config, STRONG)
    return config, loop, loop.margins()


@pytest.mark.parametrize(
    ("kind", "field", "sign"),
    [
        ("gain_up_db", "gain_db", 1.0),
        ("gain_down_db", "gain_db", -1.0),
        ("dead_time_s", "dead_time_s", 1.0),
        ("lag_s", "lag_s", 1.0),
    ],
)
def test_an_error_dies_away_within_each_margin_and_grows_beyond_it(kind, field, sign):
    """While it is so small that the flight is linear in it: all margins are those of the motion to the side."""
    config, loop, margins = strong_current()
    margin = getattr(margins, kind)
    for part in (0.85, 1.3):
        change = Change(**{field: sign * round(part * margin, 2)})  # dead time in whole steps of the plant
        aside_m = np.abs(flown(BOAT, config, STRONG, change, off_m=1e-6, cycles=200)[:, 1])
        assert loop.keeps([change]) == (part < 1.0)
        assert (aside_m[150:].max() < 5e-7) == (part < 1.0)
        assert (aside_m[150:].max() > 1e-6) == (part > 1.0)
        if kind == "dead_time_s" and part > 1.0:
            growth = (aside_m[150:].max() / aside_m[100:150].max()) ** (1 / 50)
            assert growth == pytest.approx(loop.radius(change), abs=0.01)


def test_the_gain_of_the_observer_is_that_of_the_one_that_flies():
    """Once it has settled, one velocity that is 0.1 mm/s too high changes its current by the gain times that."""
    share = 0.1  # in a stronger current the observer needs minutes to settle
    X, C = steady_state(BOAT.coefficients(), share * characteristic_scales(BOAT).speed_mps)
    profile = water(*C)
    controller = Controller(BOAT, references.Point(north_m=0.0, east_m=0.0), OBSERVING)
    for k in range(299):
        controller.plan(moving(t_ns=k * CYCLE_NS, current=profile), applied=report(k * CYCLE_NS, [*X[6:], 0.0]))
    learned = []
    for north_mps, east_mps in ((0.0, 0.0), (1e-4, 0.0), (0.0, 1e-4)):
        observer = copy.deepcopy(controller.observer)
        wrong = moving((north_mps, east_mps), t_ns=299 * CYCLE_NS, current=profile)
        observer.correct(wrong, controller.prediction)
        learned.append(observer.current[0])
    found = [(learned[1] - learned[0])[0] / 1e-4, (learned[2] - learned[0])[1] / 1e-4]
    gain = Loop(BOAT, settled(OBSERVING, BOAT), share).observer_gain
    np.testing.assert_allclose(np.diag(gain), found, rtol=0.05)


def test_a_drift_that_no_thrust_controls_is_left_out_and_the_rest_of_the_loop_is_not():
    """With M_x = M_y, v + U psi is constant: three poles at 1, which rounding would take for growing ones."""
    paper = Vehicle.load("paper")
    config = settled(ControllerConfig(), paper)
    loop = Loop(paper, config, STRONG)
    assert loop.radius() <= 1.0 + 1e-9
    margins = loop.margins()
    assert not margins.aside_controllable
    assert 6.0 < margins.gain_up_db < 20.0  # surge is controllable
    assert (
        Loop(changed(paper, {"sway.mass_kg": 1.01 * paper.sway.mass_kg}), config, STRONG).margins().aside_controllable
    )


def test_dead_time_is_continuous_across_the_cycle():
    """A command that acts in the next cycle is another state of the loop, and the same motion."""
    loop = Loop(BOAT, settled(ControllerConfig(), BOAT), 0.1)
    for known_s in (0.05, 0.25, 0.3, 0.75):
        late = Loop(BOAT, settled(ControllerConfig(first_delay_s=known_s), BOAT), 0.1)
        assert late.radius() == pytest.approx(loop.radius(), abs=1e-6)  # prediction makes up for a known delay
        below, above = (late.radius(Change(dead_time_s=0.9 - known_s + dt)) for dt in (-1e-7, 1e-7))
        assert below == pytest.approx(above, abs=1e-5)


def test_drag_that_no_stage_resolves_leaves_no_margin():
    stiff, config = changed(BOAT, {"surge.linear_damping_kgps": 9e4}), settled(ControllerConfig(), BOAT)
    loop = Loop(stiff, config, STRONG)
    assert loop.radius() == np.inf
    assert loop.margins().gain_up_db == 0.0
    assert kept_share(stiff, config) < 0.0


def test_the_weights_of_a_vehicle_that_lacks_margins_are_slower_and_given_ones_stay():
    assert proposed_slowness(Vehicle.load("paper")) == 1.0
    assert proposed_slowness(BOAT) > 2.0
    config = settled(ControllerConfig(), BOAT)
    assert kept_share(BOAT, config) > 0.0
    fast = default_weights(BOAT)
    assert kept_share(BOAT, settled(ControllerConfig(weights=WeightSettings(**msgspec.to_builtins(fast))), BOAT)) < 0.0
    given = settled(ControllerConfig(weights=WeightSettings(position_per_m2=0.01)), BOAT).weights
    assert given == msgspec.structs.replace(config.weights, position_per_m2=0.01)


def test_the_check_names_the_current_up_to_which_the_margins_suffice():
    text = " ".join(vehicle_check.table(BOAT, vehicle_check.check(BOAT)).split())
    assert "margins suffice in a current up to 0.158 m/s" in text
    assert "in none with effort high" in text
    assert "docs/robustness.md" in text
    vehicle = Vehicle.load("paper")
    paper = " ".join(vehicle_check.table(vehicle, vehicle_check.check(vehicle)).split())
    assert "docs/robustness.md" not in paper
    assert "to the side this hull reacts at second order" in paper
