"""Hulls of the strangers: facts that their equations do not contain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.strangers.flight import FOREIGN, SHIPPED, load
from benchmarks.strangers.rigid_body import Hull, Plant
from ltv_mpc.vehicle import dynamics

STEP_S = 0.01
HULLS = [*FOREIGN, "paper"]


def frictionless(hull: Hull) -> Hull:
    """Return a hull without drag, fins and restoring forces."""
    return replace(
        hull, D=np.zeros((6, 6)), quadratic=np.zeros(6), across=np.zeros((0, 2)), along=np.zeros((0, 2)),
        fin_kgpm=0.0, cancelled_munk_kg=0.0, G=np.zeros((3, 3)),
    )  # fmt: skip


@pytest.mark.parametrize("name", HULLS)
def test_without_drag_and_thrust_a_hull_keeps_its_energy(name: str) -> None:
    plant = Plant(frictionless(load(name)[0]), heading_rad=0.7, current_mps=(0.2, -0.1))
    plant.velocity[:] = 0.8, -0.2, 0.1, 0.1, -0.2, 0.3
    before = plant.velocity @ plant.hull.M @ plant.velocity
    plant.run(np.zeros((1000, 2)), STEP_S)
    assert plant.velocity @ plant.hull.M @ plant.velocity == pytest.approx(before, rel=1e-4)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_hull_of_a_shipped_vehicle_has_the_accelerations_of_the_model(name: str) -> None:
    hull, vehicle = load(name)
    plant = Plant(hull)
    nu = np.array([0.4, -0.15, 0.2])
    plant.velocity[[0, 1, 5]] = nu
    F = np.array([0.3 * hull.max_N, -0.1 * hull.max_N])
    plant.actuators[:] = F
    h = 1e-4
    plant.run(F[None], h)
    rates = dynamics.rates(nu[0], nu[1], 0.0, nu[2], *F, 0.0, 0.0, 0.0, 0.0, vehicle.coefficients())
    np.testing.assert_allclose((plant.velocity[[0, 1, 5]] - nu) / h, np.array(rates)[[2, 3, 5]], rtol=2e-3, atol=1e-4)


def test_current_and_wind_act_from_their_directions() -> None:
    plant = Plant(load("light_boat")[0], heading_rad=2.0, current_mps=(0.1, 0.2))
    track = plant.run(np.zeros((6000, 2)), STEP_S)
    np.testing.assert_allclose(track[-1, 3:5], [0.1, 0.2], atol=0.02)
    plant = Plant(load("light_boat")[0], heading_rad=2.0, force_N=(0.0, -2.0))
    track = plant.run(np.zeros((100, 2)), STEP_S)
    assert track[-1, 4] < -0.04
    assert abs(track[-1, 3]) < 0.5 * abs(track[-1, 4])
