"""Equations of motion, against physics, finite differences and an independent integrator."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

from ltv_mpc import Vehicle
from ltv_mpc.vehicle.dynamics import heave_acceleration, rates
from ltv_mpc.vehicle.flow import advance_heave, advance_stage, lag_table, substeps
from ltv_mpc.vehicle.parameters import Rotation, Translation
from ltv_mpc.vehicle.sensitivity import SCRATCH, read, thrust_gains
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")
U, V, PSI, R = range(2, 6)
# Unequal masses, arms and lags, linear and quadratic damping: nothing cancels that would hide a wrong sign.
GENERAL = changed(
    PAPER,
    {
        "dry_mass_kg": 180.0,
        "surge": Translation(mass_kg=420.0, linear_damping_kgps=7.0, quadratic_damping_kgpm=300.0),
        "sway": Translation(mass_kg=610.0, linear_damping_kgps=31.0, quadratic_damping_kgpm=900.0),
        "heave": Translation(mass_kg=330.0, linear_damping_kgps=12.0, quadratic_damping_kgpm=700.0),
        "yaw": Rotation(inertia_kgm2=150.0, linear_damping_Nms=15.0, quadratic_damping_kgm2=210.0),
        "thruster.port.arm_m": 0.25,
        "thruster.starboard.arm_m": 0.15,
        "thruster.port.lag_s": 0.2,
        "thruster.starboard.lag_s": 0.45,
    },
)
P = GENERAL.coefficients()
FREE = P._replace(**dict.fromkeys((name for name in P._fields if name.startswith(("linear", "quadratic"))), 0.0))
ZERO = np.zeros(2)

states = arrays(np.float64, 6, elements=st.floats(-2.0, 2.0, allow_subnormal=False))
pairs = arrays(np.float64, 2, elements=st.floats(-0.2, 0.2, allow_subnormal=False))
thrusts = arrays(np.float64, 2, elements=st.floats(-62.5, 62.5, allow_subnormal=False))


def slope(x, F, c=ZERO, cr=ZERO, p=P):
    return np.array(rates(*x[2:6], *F, *c, *cr, p))


@given(states)
def test_without_drag_and_thrust_kinetic_energy_is_conserved(x):
    """Coriolis forces do no work; with drag on, the paper's wrong sign would pass too."""
    dx = slope(x, ZERO, p=FREE)
    power_W = P.mass_surge * x[U] * dx[U] + P.mass_sway * x[V] * dx[V] + P.inertia_yaw * x[R] * dx[R]
    np.testing.assert_allclose(power_W, 0.0, atol=1e-9)


@given(states)
def test_without_drag_and_thrust_momentum_is_conserved_in_the_world_frame(x):
    """Kirchhoff's equations: the impulse [M_x u, M_y v] turns with the body and is constant in the water's frame."""
    dx = slope(x, ZERO, p=FREE)
    impulse = np.array([P.mass_surge * x[U], P.mass_sway * x[V]])
    rate = np.array([P.mass_surge * dx[U], P.mass_sway * dx[V]])
    turned = rate + x[R] * np.array([-impulse[1], impulse[0]])
    np.testing.assert_allclose(turned, 0.0, atol=1e-9)


@given(states, thrusts)
def test_drag_takes_energy_and_thrust_gives_its_power(x, F):
    dx, coasting = slope(x, F), slope(x, ZERO)
    masses = np.array([P.mass_surge, P.mass_sway, P.inertia_yaw])
    momenta = masses * x[[U, V, R]]
    assert momenta @ coasting[[U, V, R]] <= 1e-12
    power = F.sum() * x[U] + (F[0] * P.arm_port - F[1] * P.arm_starboard) * x[R]
    np.testing.assert_allclose(momenta @ (dx - coasting)[[U, V, R]], power, atol=1e-9)


@given(states, pairs, pairs)
def test_velocity_over_ground_is_that_through_the_water_plus_the_current(x, c, cr):
    dx = slope(x, ZERO, c, cr)
    over_ground = (x[U] + 1j * x[V]) * np.exp(1j * x[PSI]) + (c[0] + 1j * c[1])
    np.testing.assert_allclose(dx[0] + 1j * dx[1], over_ground, atol=1e-12)
    assert dx[PSI] == x[R]


@given(states, pairs)
def test_shear_leaves_the_dry_mass_at_its_velocity_over_ground(x, cr):
    """Without added mass (M = m) and drag a vehicle keeps its velocity over ground in any current."""
    m = 180.0
    p = FREE._replace(mass_surge=m, mass_sway=m, dry_mass=m)
    dx = slope(x, ZERO, ZERO, cr, p)
    turn = np.exp(1j * x[PSI])
    water = (x[U] + 1j * x[V]) * turn
    over_ground_rate = (dx[U] + 1j * dx[V]) * turn + 1j * x[R] * water + (cr[0] + 1j * cr[1])
    np.testing.assert_allclose(abs(over_ground_rate), 0.0, atol=1e-12)


def test_full_thrust_reaches_half_a_metre_a_second_ahead_and_a_fifth_down():
    """The paper's consistency: 2 x 62.5 = 500 x 0.5^2, and 62.5 - 30.5 = 800 x 0.2^2."""
    p = PAPER.coefficients()
    dx = slope(np.array([0, 0, 0.5, 0, 0, 0.0]), np.array([62.5, 62.5]), p=p)
    assert dx[U] == pytest.approx(0.0, abs=1e-12)
    assert heave_acceleration(0.2, 62.5, p) == pytest.approx(0.0, abs=1e-12)
    assert heave_acceleration(0.0, 0.0, p) < 0.0  # it rises when left alone
    assert heave_acceleration(-0.2, p.net_buoyancy, p) > 0.0  # drag brakes a rise


def test_more_thrust_to_port_turns_clockwise():
    assert slope(np.zeros(6), np.array([10.0, -10.0]))[R] > 0.0


# --- the flow over a stage -------------------------------------------------------------------------------------------


def flow(X, u0, uh, c0=ZERO, ch=ZERO, h=0.3, p=P):
    out = np.empty(8)
    advance_stage(X, u0, uh, c0, ch, h, p, lag_table(h, p), out)
    return out


def integrated(X, u0, uh, c0, ch, h, p):
    """Integrate the same motion by an eighth-order method at tight tolerance, the lag as a differential equation."""

    def rhs(t, y):
        u = u0 + (uh - u0) * t / h
        lag = (u - y[6:]) / np.array([p.lag_port, p.lag_starboard])
        return np.concatenate([slope(y[:6], y[6:], c0 + (ch - c0) * t / h, (ch - c0) / h, p), lag])

    return solve_ivp(rhs, (0, h), X, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]


def draw(rng):
    X = np.concatenate([rng.normal(size=2) * 3, rng.uniform(-0.5, 0.5, 1), rng.uniform(-0.3, 0.3, 1)])
    X = np.concatenate([X, rng.uniform(-3, 3, 1), rng.uniform(-0.4, 0.4, 1), rng.uniform(-60, 60, 2)])
    return X, rng.uniform(-60, 60, 2), rng.uniform(-60, 60, 2), rng.normal(size=2) * 0.05, rng.normal(size=2) * 0.05


@pytest.mark.parametrize(("h", "atol"), [(0.3, 1e-5), (0.7, 3e-4), (1.5, 3e-4), (3.0, 3e-4)])
def test_the_exact_discretisation_agrees_with_a_tight_independent_integrator(h, atol):
    rng = np.random.default_rng(1)
    for _ in range(40 if h == 0.3 else 5):
        X, u0, uh, c0, ch = draw(rng)
        expected = integrated(X, u0, uh, c0, ch, h, P)
        np.testing.assert_allclose(flow(X, u0, uh, c0, ch, h), expected, rtol=0, atol=atol)


def test_sensitivities_agree_with_finite_differences_of_the_exact_flow_to_1e_6():
    rng = np.random.default_rng(2)
    out, A, B0, B1 = np.empty(8), np.empty((8, 8)), np.empty((8, 2)), np.empty((8, 2))
    lag, Z = lag_table(0.3, P), np.empty(SCRATCH)
    for _ in range(40):
        X, u0, uh, c0, ch = draw(rng)
        advance_stage(X, u0, uh, c0, ch, 0.3, P, lag, out, thrust_gains(lag, P), Z)
        read(Z, lag[-1], A, B0, B1)
        np.testing.assert_allclose(out, flow(X, u0, uh, c0, ch), atol=1e-14)
        for matrix, which in ((A, 0), (B0, 1), (B1, 2)):
            for j in range(matrix.shape[1]):
                h = 1e-5 if which == 0 and j < 6 else 1e-2
                plus, minus = [X.copy(), u0.copy(), uh.copy()], [X.copy(), u0.copy(), uh.copy()]
                plus[which][j] += h
                minus[which][j] -= h
                difference = (flow(*plus, c0, ch) - flow(*minus, c0, ch)) / (2 * h)
                scale = max(np.abs(matrix[:, j]).max(), 1e-3)
                np.testing.assert_allclose(difference, matrix[:, j], rtol=0, atol=1e-6 * scale)


def test_a_thruster_reaches_63_percent_of_a_step_after_its_lag():
    step = flow(np.zeros(8), np.full(2, 10.0), np.full(2, 10.0), h=P.lag_port)
    assert step[6] == pytest.approx(10.0 * (1 - np.exp(-1)), rel=1e-12)


def test_without_lag_a_thruster_delivers_its_command():
    """The motion follows the command at every instant, not only at the end of a stage."""
    p = P._replace(lag_port=0.0, lag_starboard=0.0)
    X, u0, uh = np.zeros(8), np.array([-40.0, 25.0]), np.array([7.0, -3.0])

    def rhs(t, y):
        return slope(y, u0 + (uh - u0) * t / 0.3, p=p)

    end = flow(X, u0, uh, p=p)
    np.testing.assert_allclose(end[6:], [7.0, -3.0])
    want = solve_ivp(rhs, (0, 0.3), X[:6], method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(end[:6], want, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("seconds", "steps"), [(0.3, 2), (0.31, 3), (0.45, 3), (0.15, 1), (0.02, 1), (0.7, 4), (1.5, 5)]
)
def test_a_stage_is_cut_into_no_more_steps_than_its_length_needs(seconds, steps):
    """0.45 / 0.15 is not 3 in binary."""
    assert substeps(seconds) == steps


@settings(max_examples=25)
@given(st.floats(-0.5, 0.5), st.floats(-60, 60), st.floats(-60, 60), st.floats(-60, 60))
def test_heave_agrees_with_a_tight_independent_integrator(w, F, u0, uh):
    def rhs(t, y):
        u = u0 + (uh - u0) * t / 0.3
        return [y[1], heave_acceleration(y[1], y[2], P), (u - y[2]) / P.lag_vertical]

    want = solve_ivp(rhs, (0, 0.3), [5.0, w, F], method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(advance_heave(5.0, w, F, u0, uh, 0.3, P), want, atol=5e-6)
