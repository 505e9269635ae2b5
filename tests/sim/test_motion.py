"""Motion of the true vehicle against conservation laws, closed forms and an independent integration."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from sim import motion
from sim.motion import apply_mismatch
from sim.scenario import Mismatch
from sim.water.column import WaterSample

PAPER = Vehicle.load("paper").coefficients()
UNEQUAL = PAPER._replace(mass_surge=350.0, mass_sway=520.0, linear_surge=9.0, linear_sway=21.0, linear_heave=4.0)
RHO, DIAMETER, N_MAX = 1025.0, 0.25, 7.2
DEPTHS = np.arange(71.0)
STILL = np.zeros((71, 2))
H = 0.01


def travel(
    s: list[float],
    commands: np.ndarray,
    p: Coefficients,
    *,
    current: np.ndarray = STILL,
    lag: float = 0.3,
    factor: float = 1.0,
    held: bool = False,
    h: float = H,
    limit_N: float = 90.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states (T, 8), revolutions (T, 3) and thrusts (T, 3) for commands (T, 3), one for each step."""
    state, n, F = np.array(s, dtype=float), np.zeros(3), np.zeros(3)
    vehicle = motion.MotionState(state, n, F)
    water = WaterSample(DEPTHS, current, current, 0.0)
    body = np.array([*p, *3 * [DIAMETER, N_MAX, lag, -limit_N, limit_N], RHO, *3 * [factor]])
    states, revs, thrusts = [state.copy()], [n.copy()], [F.copy()]
    for y0, y1 in pairwise(commands):
        motion.step(body, vehicle, y0, y1, held, h, water)
        states.append(state.copy())
        revs.append(n.copy())
        thrusts.append(F.copy())
    return np.array(states), np.array(revs), np.array(thrusts)


def constant(seconds: float, *thrust: float) -> np.ndarray:
    return np.tile(thrust, (round(seconds / H) + 1, 1))


def equations(t, x, p, command, lag, current):
    """Return the derivative by the equations of sim/motion.py, written again for scalars and a continuous governor."""
    u, v, psi, r, z, w, n1, n2, n3 = x[2:]
    m_x, m_y, m_z, i_z = p.mass_surge, p.mass_sway, p.mass_heave, p.inertia_yaw
    a, b = 0.4 * RHO * DIAMETER**4, RHO * DIAMETER**3 / 3

    def governed(F, inflow):
        roots = np.roots([a, -b * inflow, -F]) if F > 0 else -np.roots([a, b * inflow, F])
        real = [x for x in roots.real if x * F > 0]
        return min(max(real[0] if real else 0.0, -N_MAX), N_MAX)

    def eq8(n, inflow):
        return a * abs(n) * n - b * inflow * abs(n)

    y = command(t)
    F1, F2, F3 = eq8(n1, u), eq8(n2, u), eq8(n3, w)
    c = [np.interp(z, DEPTHS, current[:, i]) for i in range(2)]
    slope = [np.interp(z + 1e-6, DEPTHS, current[:, i]) - np.interp(z - 1e-6, DEPTHS, current[:, i]) for i in range(2)]
    shear_n, shear_e = slope[0] / 2e-6 * w, slope[1] / 2e-6 * w
    cos, sin = math.cos(psi), math.sin(psi)
    return [
        cos * u - sin * v + c[0],
        sin * u + cos * v + c[1],
        (F1 + F2 - p.linear_surge * u - p.quadratic_surge * u * abs(u) + m_y * v * r) / m_x
        - p.dry_mass / m_x * (cos * shear_n + sin * shear_e),
        (-p.linear_sway * v - p.quadratic_sway * v * abs(v) - m_x * u * r) / m_y
        - p.dry_mass / m_y * (-sin * shear_n + cos * shear_e),
        r,
        ((F1 - F2) * 0.2 - p.linear_yaw * r - p.quadratic_yaw * r * abs(r) + (m_x - m_y) * u * v) / i_z,
        w,
        (F3 - p.linear_heave * w - p.quadratic_heave * w * abs(w) - p.net_buoyancy) / m_z,
        (governed(y[0], u) - n1) / lag,
        (governed(y[1], u) - n2) / lag,
        (governed(y[2], w) - n3) / lag,
    ]


def test_the_motion_is_that_of_an_independent_integration_of_the_equations():
    def command(t):
        return 30 + 25 * math.sin(0.9 * t), 35 - 20 * math.sin(0.7 * t + 0.4), 50 + 10 * math.cos(0.5 * t)

    smooth = np.column_stack([0.1 * np.sin(DEPTHS / 9.0), 0.1 * np.cos(DEPTHS / 7.0)])
    start = [1.0, -2.0, 0.2, -0.05, 0.4, 0.03, 5.2, 0.1]
    times = np.arange(0.0, 20.0 + H / 2, H)
    states, revs, _ = travel(start, np.array([command(t) for t in times]), UNEQUAL, current=smooth)
    exact = solve_ivp(
        equations, (0, 20), [*start, 0, 0, 0], args=(UNEQUAL, command, 0.3, smooth), rtol=1e-7, atol=1e-9, max_step=0.2
    ).y[:, -1]
    # The plant's governor sees the inflow of the step's start, 10 ms late at most: below 1e-3 in each quantity.
    np.testing.assert_allclose(states[-1], exact[:8], atol=1e-3)
    np.testing.assert_allclose(revs[-1], exact[8:], atol=3e-3)


@pytest.mark.parametrize("lag", [0.0, 1e-9, 0.1, 0.3, 1.0])
def test_revolutions_follow_with_the_lags_time_constant(lag):
    heavy = PAPER._replace(mass_surge=1e7, mass_sway=1e7, mass_heave=1e7, inertia_yaw=1e7)
    _, revs, thrusts = travel([0] * 8, constant(max(5 * lag, 0.1), 40, -40, 40), heavy, lag=lag, held=True)
    asked = math.sqrt(40 / (0.4 * RHO * DIAMETER**4))
    if lag < 1e-3:
        np.testing.assert_allclose(thrusts[1:], np.tile([40, -40, 40], (len(thrusts) - 1, 1)), atol=1e-3)
    else:
        k = round(lag / H)
        np.testing.assert_allclose(revs[k], asked * (1 - math.exp(-1)) * np.array([1, -1, 1]), rtol=1e-4)


def test_thrust_is_delivered_as_commanded_up_to_the_propellers_top_speed():
    heavy = PAPER._replace(mass_surge=1e9, mass_sway=1e9, mass_heave=1e9, inertia_yaw=1e9)
    for inflow in (-0.3, 0.0, 0.4):
        for F in np.linspace(-90, 90, 37):
            _, revs, thrusts = travel([0, 0, inflow, 0, 0, 0, 9, 0], constant(0.02, F, F, 0), heavy, lag=0.0)
            most = 0.4 * RHO * DIAMETER**4 * N_MAX**2 - inflow * RHO * DIAMETER**3 * N_MAX / 3
            least = -0.4 * RHO * DIAMETER**4 * N_MAX**2 - inflow * RHO * DIAMETER**3 * N_MAX / 3
            assert np.abs(revs).max() <= N_MAX
            assert thrusts[-1, 0] == pytest.approx(min(max(F, least), most), abs=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_delivered_thrust_stays_within_the_limits_while_the_vehicle_slows_down(sign):
    """The propellers still turn as fast as the earlier inflow required, so eq 8 alone gives more than the limit."""
    start = [0, 0, 1.5 * sign, 0, 0, 0, 9, 1.5 * sign]
    _, _, thrusts = travel(start, constant(5, *3 * [62.5 * sign]), PAPER, limit_N=62.5)
    assert np.abs(thrusts).max() == 62.5


def test_a_weaker_thruster_pushes_less_than_eq_8_says_of_its_revolutions():
    half, _, said = travel([0] * 8, constant(0.5, 20, 20, 0), PAPER, factor=0.5)
    full, _, _ = travel([0] * 8, constant(0.5, 10, 10, 0), PAPER)
    assert said[-1, 0] == pytest.approx(20 * (1 - math.exp(-0.5 / 0.3)) ** 2, rel=0.02)
    assert half[-1, 2] == pytest.approx(full[-1, 2], rel=0.03)


def test_a_buoyant_vehicle_rises_to_the_surface_and_stays_until_vertical_thrust_beats_the_buoyancy():
    states, _, _ = travel([0, 0, 0, 0, 0, 0, 1.0, 0], constant(30, 0, 0, 0), PAPER)
    depth, w = states[:, 6], states[:, 7]
    assert depth.min() == 0.0
    assert w.min() == pytest.approx(-math.sqrt(30.5 / 800), abs=1e-3)
    assert not states[-1000:, 6:].any()
    weak, strong = (travel([0] * 8, constant(5, 0, 0, F), PAPER)[0][-1, 6] for F in (30, 32))
    assert weak == 0.0 < strong
    held, _, _ = travel([0, 0, 0, 0, 0, 0, 20.0, 0], constant(5, 0, 0, 0), PAPER, held=True)
    assert (held[:, 6] == 20.0).all()


def test_mismatch_scales_masses_and_damping_and_leaves_the_rest():
    true = apply_mismatch(UNEQUAL, Mismatch(mass=1.1, drag=0.8))
    ratio = {name: getattr(true, name) / value for name, value in UNEQUAL._asdict().items() if value}
    masses = {"mass_surge", "mass_sway", "mass_heave", "inertia_yaw", "dry_mass"}
    assert ratio == {
        name: pytest.approx(1.1 if name in masses else 0.8 if name.startswith(("linear", "quadratic")) else 1.0)
        for name in ratio
    }
