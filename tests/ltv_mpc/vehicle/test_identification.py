"""Identification: coefficients recovered from the motion of a vehicle, by an independent integrator."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ltv_mpc import Vehicle
from ltv_mpc.vehicle.dynamics import rates
from ltv_mpc.vehicle.identification import CannotIdentify, Identification, NotEnoughMotion, identify, with_coefficients
from ltv_mpc.vehicle.reference_point import ReferencePoint
from ltv_mpc.vehicle.shooting_fit import Motion, ShootingFit, segments
from tests.foreign_plant import plant
from tests.ltv_mpc.vehicles import changed

BELIEVED = Vehicle.load("paper")
TRUE = {
    "mass_surge": 420.0,
    "mass_sway": 610.0,
    "inertia_yaw": 150.0,
    "linear_surge": 30.0,
    "quadratic_surge": 400.0,
    "linear_sway": 60.0,
    "quadratic_sway": 1000.0,
    "linear_yaw": 20.0,
    "quadratic_yaw": 160.0,
    "arm_port": 0.24,
    "arm_starboard": 0.16,
    "lag_port": 0.2,
    "lag_starboard": 0.45,
    "thrust": 1.0,
    "reference_forward": 0.0,
    "reference_starboard": 0.0,
}
H = 0.1


def moved(seconds: float, seed: int, *, commands=None, sd=(0.0, 0.0, 0.0), true=TRUE, current=(0.0, 0.0)) -> Motion:
    """Random steps of both thrusts, ramped within 0.5 s, each held for 4 s, unless ``commands`` (M, 2) are given.

    The velocities are those of the true reference point and contain ``current`` (2,), north and east.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, H)
    if commands is None:
        knots = np.arange(0.0, seconds + 5.0, 4.0)
        level = rng.uniform(-50, 60, (len(knots), 2))
        at = np.ravel(np.column_stack([knots, knots + 3.5]))
        commands = np.column_stack([np.interp(t, at, np.repeat(level[:, i], 2)) for i in range(2)])

    p = BELIEVED.coefficients()
    p = p._replace(**{name: value for name, value in true.items() if name in p._fields})
    lag, scale = np.array([p.lag_port, p.lag_starboard]), true["thrust"]

    def slopes(now: float, y: np.ndarray) -> list[float]:
        command = np.array([np.interp(now, t, commands[:, i]) for i in range(2)])
        _, _, du, dv, _, dr = rates(y[0], y[1], 0.0, y[2], *(scale * y[3:5]), 0.0, 0.0, 0.0, 0.0, p)
        return [du, dv, dr, *((command - y[3:5]) / lag), y[2]]

    start = [0.0, 0.0, 0.0, *commands[0], 0.0]
    y = solve_ivp(slopes, (0.0, t[-1]), start, t_eval=t, rtol=1e-8, atol=1e-9, max_step=H).y.T
    cos, sin = np.cos(y[:, 5]), np.sin(y[:, 5])
    north, east = current
    over_ground = y[:, :3] + np.column_stack([cos * north + sin * east, cos * east - sin * north, 0.0 * t])
    over_ground[:, 0] -= y[:, 2] * true["reference_starboard"]
    over_ground[:, 1] += y[:, 2] * true["reference_forward"]
    return Motion(
        t_s=t,
        velocity=over_ground + rng.standard_normal((len(t), 3)) * sd,
        heading=y[:, 5],
        shear=np.zeros((len(t), 2)),
        command=commands,
        sd=np.maximum(sd, 1e-4),
        thrust=y[:, 3:5],
    )


def values(of: Identification) -> dict[str, float]:
    return {one.name: one.value for one in of.coefficients}


ARMS = changed(BELIEVED, {"thruster.port.arm_m": 0.24, "thruster.starboard.arm_m": 0.16})
"""Vehicle file with correct arms, and wrong masses and damping."""


ANTENNA = {**TRUE, "reference_forward": 0.5, "reference_starboard": -0.3}
SD = (0.005, 0.005, 0.002)
"""Standard deviations of the errors of a usual log."""


CURRENT = (0.25, -0.15)


@pytest.fixture(scope="module")
def clean() -> Motion:
    """Return a motion without errors, in a current and of a reference point that the file does not have."""
    return moved(90.0, 1, current=CURRENT, true=ANTENNA)


@pytest.fixture(scope="module")
def found(clean: Motion) -> Identification:
    return identify(ARMS, clean)


@pytest.fixture(scope="module")
def short() -> Motion:
    return moved(30.0, 1)


def assert_true(found: Identification, true: dict[str, float]) -> None:
    """Assert that all intervals but those of lags, whose reports have no errors here, contain the truth."""
    for one in found.coefficients:
        if one.excited and not one.name.startswith("lag"):
            assert one.low - 1e-9 <= true[one.name] <= one.high, one.name


def assert_recovered(found: Identification) -> None:
    """Assert that all coefficients but those taken from the file are the truth, and so is the current."""
    np.testing.assert_allclose(found.current_mps, CURRENT, atol=0.003)
    assert set(values(found)) == set(TRUE) - {"thrust", "arm_port", "arm_starboard"}
    for name, value in values(found).items():
        assert value == pytest.approx(ANTENNA[name], rel=0.03, abs=0.005), name


def test_without_errors_all_coefficients_are_recovered_and_become_a_vehicle(found: Identification) -> None:
    assert_recovered(found)
    better = with_coefficients(ARMS, found.coefficients)
    coefficients = better.coefficients()._asdict()
    for one in found.coefficients:
        assert one.value == coefficients.get(one.name, one.value), one.name
    assert better.heave == ARMS.heave
    point = better.reference_point
    assert (point.forward_m, point.starboard_m, point.down_m) == pytest.approx((0.5, -0.3, 0.0), abs=0.005)


def test_without_reports_the_lags_are_recovered_too(clean: Motion) -> None:
    assert_recovered(identify(ARMS, clean._replace(thrust=None)))


def test_an_identified_thrust_scale_is_that_of_the_lateral_thrusters(found: Identification) -> None:
    scaled = with_coefficients(ARMS, [msgspec.structs.replace(found.coefficients[0], name="thrust", value=0.8)])
    assert scaled.thruster.port.max_N == pytest.approx(50.0)
    assert scaled.thruster.starboard.min_N == pytest.approx(-50.0)
    assert scaled.thruster.vertical == ARMS.thruster.vertical


def test_a_declared_reference_point_is_kept_and_the_contradiction_is_reported() -> None:
    """The motion is that of the declared origin, so what it shows adds to the file's values."""
    declared = msgspec.structs.replace(
        ARMS, reference_point=ReferencePoint(forward_m=1.0, starboard_m=0.2, down_m=-1.0)
    )
    found = identify(declared, moved(60.0, 1, sd=SD, true=ANTENNA))
    points = {one.name: one for one in found.coefficients if one.name.startswith("reference")}
    for name, shown in (("reference_forward", 1.5), ("reference_starboard", -0.1)):
        one = points[name]
        assert one.declared
        assert one.value == one.file
        assert one.low < shown < one.high
        (warning,) = (text for text in found.warnings if name in text)
        assert f"{one.file:.4g} m: its 95 % interval is {one.low:.4g} to {one.high:.4g} m" in warning
    assert with_coefficients(declared, found.coefficients).reference_point == declared.reference_point
    assert_true(found, TRUE)  # fitted with a wrong point, but the intervals contain both fits


def test_a_declared_reference_point_that_the_log_confirms_is_kept_without_a_warning() -> None:
    """A table of zeros in the file is a declaration too."""
    point = ReferencePoint()
    declared = msgspec.structs.replace(ARMS, reference_point=point)
    found = identify(declared, moved(60.0, 4, sd=SD))
    assert found.warnings == []
    assert with_coefficients(declared, found.coefficients).reference_point == point
    for one in found.coefficients:
        if one.name.startswith("reference"):
            assert one.declared
            assert one.low < one.file == one.value < one.high


def test_no_mass_is_below_the_dry_mass() -> None:
    """Thrusts that are reported three times too small would make the vehicle lighter than it is dry."""
    noisy = moved(60.0, 1, sd=SD)
    assert noisy.thrust is not None
    found = identify(ARMS, noisy._replace(thrust=noisy.thrust / 3.0))
    by_name = {one.name: one for one in found.coefficients}
    assert by_name["mass_surge"].value == pytest.approx(200.0, abs=0.01)
    assert by_name["mass_sway"].value >= 200.0
    assert any("mass_surge is at its bound, dry_mass_kg = 200" in text for text in found.warnings)


def test_a_file_with_a_mass_below_the_dry_mass_is_a_start_too(short: Motion) -> None:
    found = values(identify(changed(ARMS, {"surge.mass_kg": 100.0}), short))
    assert found["mass_surge"] == pytest.approx(420.0, rel=0.03)


def wild(motion: Motion) -> dict[str, Motion]:
    """Motions of which no model can say anything."""
    rng, n = np.random.default_rng(0), len(motion.t_s)
    zeros = np.zeros((n, 2))
    spikes = np.where(rng.random((n, 1)) < 0.01, 1e3, motion.velocity)
    return {
        "at rest": motion._replace(velocity=np.zeros((n, 3)), command=zeros, thrust=zeros),
        "noise": motion._replace(velocity=rng.standard_normal((n, 3)) * [1.0, 1.0, 0.5]),
        "spikes": motion._replace(velocity=spikes),
        "huge thrust": motion._replace(thrust=1e5 * rng.standard_normal((n, 2))),
        "towed without thrust": motion._replace(thrust=zeros, command=zeros),
    }


LIGHT = changed(ARMS, {"yaw.inertia_kgm2": 1.0})
"""Vehicle file whose yaw damping is faster than a step of the integration."""


@pytest.mark.parametrize(("vehicle", "name"), [*((ARMS, name) for name in wild(moved(1.0, 1))), (LIGHT, "noise")])
def test_a_log_of_anything_gives_finite_coefficients_or_one_error(vehicle: Vehicle, name: str, short: Motion) -> None:
    try:
        found = identify(vehicle, wild(short)[name])
    except CannotIdentify as error:
        assert "\n" not in str(error)  # noqa: PT017
        return
    for one in found.coefficients:
        assert np.all(np.isfinite([one.value, one.low, one.high])), one.name
        assert one.name.startswith("reference") or one.value >= 0.0, one.name
    with_coefficients(vehicle, found.coefficients)


def test_a_vehicle_at_rest_and_a_run_that_is_too_short_show_nothing(short: Motion) -> None:
    with pytest.raises(NotEnoughMotion, match="are constant"):
        identify(ARMS, wild(short)["at rest"])
    with pytest.raises(NotEnoughMotion, match="at least 5 are needed"):
        identify(ARMS, Motion(*(x if x is None or len(x) == 3 else x[:200] for x in short)))


def swum(seed: int, sd: tuple[float, float, float]) -> Motion:
    """150 s of random thrusts of the hull of ``tests/foreign_plant``, which has fins and coupled sway and yaw."""
    rng, hull = np.random.default_rng(seed), plant.Hull(heading_rad=0.3, current_mps=(0.1, -0.1))
    command, target, change_s = np.zeros(2), np.zeros(2), 0.0
    rows = []
    for k in range(round(150.0 / plant.STEP_S)):
        if k * plant.STEP_S >= change_s:
            change_s += rng.uniform(3.0, 9.0)
            target = rng.uniform(-28.0, 40.0, 2)
            target[1] = target[0] if rng.random() < 0.3 else target[1]
        command = command + np.clip(target - command, -1.6, 1.6)
        if k % 5 == 0:
            now = hull.estimate(0)
            cos, sin = np.cos(now["heading_rad"]), np.sin(now["heading_rad"])
            north, east = now["velocity_north_mps"], now["velocity_east_mps"]
            of_origin = cos * north + sin * east, cos * east - sin * north, now["yaw_rate_radps"]
            rows.append((k * plant.STEP_S, *of_origin, now["heading_rad"], *command, *hull.thrust_N))
        hull.step((float(command[0]), float(command[1])))
    table = np.array(rows)
    return Motion(
        t_s=table[:, 0],
        velocity=table[:, 1:4] + rng.standard_normal((len(table), 3)) * sd,
        heading=np.unwrap(table[:, 4]),
        shear=np.zeros((len(table), 2)),
        command=table[:, 5:7],
        sd=np.maximum(sd, 1e-3),
        thrust=table[:, 7:9],
    )


FOREIGN = Vehicle.load(str(Path(plant.__file__).with_name("hull.toml")))
FOREIGN_TRUE = {
    "mass_surge": plant.SURGE,
    "mass_sway": plant.SWAY,
    "inertia_yaw": plant.YAW,
    "reference_forward": 0.0,
    "reference_starboard": 0.0,
} | {
    f"{kind}_{axis}": row[i]
    for kind, row in (("linear", plant.LINEAR), ("quadratic", plant.QUADRATIC))
    for axis, i in (("surge", 0), ("sway", 1), ("yaw", 5))
}


def test_a_hull_of_another_structure_is_reported_and_the_intervals_contain_its_truth() -> None:
    found = identify(FOREIGN, swum(1, SD))
    assert any("structure of the model does not fit" in text and "in yaw" in text for text in found.warnings)
    for one in found.coefficients:
        assert one.low <= FOREIGN_TRUE.get(one.name, one.value) <= one.high, one.name


def test_purely_linear_drag_is_within_the_structure() -> None:
    linear = {**TRUE, "quadratic_surge": 0.0, "quadratic_sway": 0.0, "quadratic_yaw": 0.0}
    linear |= {"linear_surge": 150.0, "linear_sway": 220.0, "linear_yaw": 70.0}
    found = identify(changed(ARMS, {"surge.quadratic_damping_kgpm": 0.0}), moved(60.0, 3, sd=SD, true=linear))
    assert found.warnings == []
    assert_true(found, linear)


def test_unequal_residuals_ahead_and_abeam_are_reported() -> None:
    """A tow ahead that nothing in the log shows: the estimates' errors would be alike in both directions."""
    motion = moved(60.0, 2, sd=(0.002, 0.002, 0.001))
    pulled = motion.velocity.copy()
    pulled[:, 0] += 0.05 * np.cumsum(np.random.default_rng(9).standard_normal(len(pulled))) / np.sqrt(10.0)
    found = identify(ARMS, motion._replace(velocity=pulled))
    assert any("the residual ahead" in text and "times the one abeam" in text for text in found.warnings)


def test_the_intervals_contain_truth_unknown_current_and_reference_point() -> None:
    inside, of_point = [], []
    for seed in range(2):
        current = 0.3 * np.array([np.cos(seed), np.sin(seed)])
        found = identify(ARMS, moved(60.0, seed, sd=SD, current=current, true=ANTENNA))
        inside += (np.abs(found.current_mps - current) <= found.current_half_mps).tolist()
        for one in found.coefficients:
            if one.name.startswith("lag"):  # the reports have no errors here
                continue
            point = one.name.startswith("reference")
            (of_point if point else inside).append(one.low <= ANTENNA[one.name] <= one.high)
            assert one.excited or not point
        assert found.warnings == []
    assert np.mean(inside) >= 0.9
    assert np.mean(of_point) >= 0.9


def test_with_known_masses_thrust_scale_and_arms_are_identified() -> None:
    true = {**TRUE, "mass_surge": 500.0, "inertia_yaw": 179.049, "thrust": 0.8}
    found = values(identify(BELIEVED, moved(60.0, 2, true=true), "mass", "inertia"))
    assert set(found) == set(TRUE) - {"mass_surge", "inertia_yaw"}
    assert found["thrust"] == pytest.approx(0.8, rel=0.01)
    # The moment is what is seen: arms times the scale, and both scales are excited apart by surge.
    assert found["arm_port"] == pytest.approx(0.24, rel=0.02)
    assert found["arm_starboard"] == pytest.approx(0.16, rel=0.02)


def test_shear_acts_on_the_dry_mass() -> None:
    """A vehicle drifts without thrust in accelerating water, u' = - m / M c', which the model explains."""
    motion = moved(60.0, 3)
    gone = motion.velocity.copy()
    # north is ahead here: dry mass 200 kg of 500 in the file, 168 of 420 in truth
    gone[:, 0] -= 0.4 * 0.001 * motion.t_s
    still = motion._replace(heading=0.0 * motion.heading, command=0.0 * motion.command, thrust=0.0 * motion.command)
    drifting = still._replace(velocity=np.column_stack([gone[:, 0] - motion.velocity[:, 0], *np.zeros((2, len(gone)))]))
    sheared = drifting._replace(shear=np.column_stack([np.full(len(gone), 0.001), np.zeros(len(gone))]))
    off = []
    for one in (sheared, drifting):
        fit = ShootingFit(ARMS, one, ["mass_surge"])
        off.append(float(np.linalg.norm(fit.residuals(fit.origin))))
    assert off[0] < 0.5 * off[1]


def test_unexcited_coefficients_are_reported_and_keep_their_value() -> None:
    """The vehicle moves straight ahead, faster and slower, without turns or sway."""
    t = np.arange(0.0, 60.0, H)
    both = np.repeat((20.0 + 20.0 * np.sign(np.sin(0.4 * t)))[:, None], 2, axis=1)
    even = {**TRUE, "arm_port": 0.2, "arm_starboard": 0.2, "lag_starboard": 0.2}
    wrong = changed(BELIEVED, {"surge.linear_damping_kgps": 12.0, "surge.quadratic_damping_kgpm": 90.0})
    found = identify(wrong, moved(60.0, 5, commands=both, sd=SD, true=even)).coefficients
    excited = {one.name for one in found if one.excited}
    assert "mass_surge" in excited
    turning = {name for name in TRUE if name.endswith(("sway", "yaw")) or name.startswith("reference")}
    assert excited.isdisjoint({*turning, "linear_surge"})
    assert all(one.value == one.file for one in found if not one.excited)
    kept = with_coefficients(wrong, found)
    assert (kept.sway, kept.yaw, kept.reference_point) == (wrong.sway, wrong.yaw, wrong.reference_point)
    assert kept.surge.linear_damping_kgps == wrong.surge.linear_damping_kgps


def test_segments_end_at_gaps() -> None:
    t = np.concatenate([np.arange(0.0, 13.0, 0.1), np.arange(20.0, 22.0, 0.1)])
    assert [(round(t[a], 1), round(t[b - 1], 1)) for a, b in segments(t)] == [(0.0, 6.0), (6.1, 12.1)]
