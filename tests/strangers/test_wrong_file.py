"""A vehicle whose file is wrong: the controller learns the vehicle, follows its path, and names what is wrong."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
import shapely

from benchmarks.observer import judged
from benchmarks.robustness.cases import RIGHT
from benchmarks.robustness.flights import Row
from benchmarks.strangers.flight import Conditions, Flight, Ours, Start, fly, load
from benchmarks.strangers.tasks import SQUARE, reference
from ltv_mpc import Vehicle
from ltv_mpc.messages import Estimate

CURRENT = Conditions(current_mps=0.3)
NOISE_MPS, NOISE_RADPS = 0.03, 0.02


def wrong(vehicle: Vehicle, *, mass: float = 1.0, drag: float = 1.0, arm: float = 1.0) -> Vehicle:
    """Return a vehicle file with factors on its masses and inertia, its damping and its arms."""
    fields = msgspec.to_builtins(vehicle)
    for axis in ("surge", "sway", "yaw"):
        for name in fields[axis]:
            fields[axis][name] *= drag if "damping" in name else mass
    for side in ("port", "starboard"):
        fields["thruster"][side]["arm_m"] *= arm
    return msgspec.convert({**fields, "dry_mass_kg": mass * vehicle.dry_mass_kg}, Vehicle)


def along_a_square(vehicle: Vehicle, pilot_class: type[Ours] = Ours) -> tuple[Ours, Flight, float]:
    """Fly the light boat with a file; return its pilot, the flight, and the mean distance from the path after 10 s."""
    pilot = pilot_class(vehicle, reference(SQUARE, 0.9))
    flight = fly("bluerobotics-boat", pilot, CURRENT, Start(current_rad=0.6), duration_s=85.0)
    off = shapely.distance(shapely.LineString(SQUARE), shapely.points(flight.point))
    return pilot, flight, float(off[flight.t_s > 10.0].mean())


@pytest.mark.parametrize(
    ("factors", "named"),
    [
        ({"mass": 2.0}, "mass ahead looks 0."),
        ({"mass": 2.0, "drag": 0.5, "arm": 0.7}, "drag ahead looks 2 of"),
    ],
)
def test_a_wrong_file_is_learned_and_named_within_two_corners(factors, named):
    vehicle = load("bluerobotics-boat")[1]
    pilot, flight, off_m = along_a_square(wrong(vehicle, **factors))
    assert off_m < 0.2
    assert named in pilot.controller.vehicle_file_check.why
    assert not flight.nominal[flight.t_s > 60.0].any()


def test_a_drag_in_yaw_of_six_times_the_file_s_is_learned_and_named():
    """The catamaran's, in a current that nothing tells and without reports; at its corners it can turn no faster."""
    hull, vehicle = load("catamaran")
    pilot = Ours(vehicle, reference(SQUARE, 1.0))
    conditions = Conditions(current_mps=0.2 * hull.top_speed_mps(), reports_s=0.0)
    fly("catamaran", pilot, conditions, Start.drawn(2, 0.3), duration_s=60.0)
    assert math.exp(pilot.controller.observer.save().mean[9]) > 3.0
    assert "drag in yaw looks 6." in pilot.controller.vehicle_file_check.why


@pytest.mark.parametrize(
    ("hull", "case", "named"),
    [
        ("surface", RIGHT, ""),
        ("bluerobotics-boat", "wind=0.1 gust=0.05", ""),
        ("surface", "waves_V=0.15", ""),
        ("surface", "drag=0.5", "drag ahead"),
    ],
)
def test_gusts_and_waves_are_no_wrong_file_and_a_wrong_one_is_named_within_30_s_of_its_second_corner(hull, case, named):
    """With errors of the estimated velocity, and a current that nothing tells."""
    run = judged((Row(hull, "square", case), 1))
    assert run.named.startswith(named)
    assert run.after_s < 30.0 if named else not run.named
    assert case != RIGHT or (0.2 < run.nis < 3.0 and run.many < 0.01)


def test_the_right_file_is_kept_and_nothing_is_named():
    pilot, flight, off_m = along_a_square(load("bluerobotics-boat")[1])
    assert off_m < 0.12
    np.testing.assert_allclose(pilot.controller.observer.save().mean[4:], 0.0, atol=0.05)
    assert flight.nominal[flight.t_s > 1.0].all()


class Noisy(Ours):
    """Pilot whose estimates of the velocities have white noise, and no covariance."""

    rng = np.random.default_rng(5)

    def plan(self, estimate: Estimate, t_ns, applied):
        north, east, yaw = self.rng.normal(size=3).tolist()
        given = msgspec.structs.replace(
            estimate,
            velocity_north_mps=estimate.velocity_north_mps + NOISE_MPS * north,
            velocity_east_mps=estimate.velocity_east_mps + NOISE_MPS * east,
            yaw_rate_radps=estimate.yaw_rate_radps + NOISE_RADPS * yaw,
        )
        return super().plan(given, t_ns, applied)


def test_noise_of_the_velocities_is_no_damping():
    """Without the filter of the velocities the mass and the drag abeam go to their bounds."""
    pilot, flight, off_m = along_a_square(load("bluerobotics-boat")[1], Noisy)
    assert off_m < 0.15
    assert np.abs(pilot.controller.observer.save().mean[4:10]).max() < 0.5
    assert flight.nominal[flight.t_s > 1.0].all()


class Swapped(Ours):
    """The cables of the thrusters are swapped."""

    def plan(self, *of):
        knots_ns, thrust_N = super().plan(*of)
        return knots_ns, thrust_N[:, ::-1]


def test_swapped_thrusters_are_named_while_the_vehicle_goes_wrong():
    pilot = Swapped(load("bluerobotics-boat")[1], reference(((0.0, 0.0), (40.0, 0.0)), 1.2))
    flight = fly("bluerobotics-boat", pilot, Conditions(reports_s=0.0), Start(heading_rad=0.5), duration_s=60.0)
    assert "port and starboard thruster are swapped" in pilot.controller.vehicle_file_check.why
    assert not flight.nominal[flight.t_s > 50.0].any()
