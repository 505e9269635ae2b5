"""One flight of a hull, steered through the public interface: what its navigation says goes in, a plan comes out.

The loop has the instants of a vehicle: the hull is simulated in steps of 10 ms, the navigation gives an estimate each
0.1 s, a cycle of the controller begins each 0.3 s with the newest estimate, and its plan arrives 0.1 s later. A
rival computes a thrust from each estimate, which is in force at once. The thrusters follow the newest plan that has
begun, within the slew of the vehicle file. A condition changes one of these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple, Protocol

import msgspec
import numpy as np
import numpy.typing as npt

from benchmarks.strangers import catamaran, drawn, ellipsoid, light_boat
from benchmarks.strangers.rigid_body import Hull, Plant
from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle
from ltv_mpc.messages import Applied, Array, Health, Pair
from ltv_mpc.references import Reference
from sim.plant import CommandPath
from sim.plant import Wind as WindForce
from sim.scenario import Actuators, Mismatch, Water, Wind
from sim.water import make

HERE = Path(__file__).parent
AS_IN_FILE, DIRECT, STILL, CALM = Mismatch(), Actuators(), Water(sd_mps=0.0), Wind()
FOREIGN = {"catamaran": catamaran.hull, "ellipsoid": ellipsoid.hull, "light_boat": light_boat.hull}
"""Hulls of another structure than the model."""
SHIPPED = ("paper", "surface", "bluerobotics-boat", "low-yaw", "weak-reverse")
"""Vehicles of the package, flown with the model's own equations."""

STEP_NS, STEP_S = 10_000_000, 0.01
CHUNK = 10
"""Steps between two looks at what has arrived."""
NORTH, EAST, HEADING, VELOCITY_NORTH, VELOCITY_EAST, YAW_RATE, PORT, STARBOARD = range(8)


@cache
def load(name: str) -> tuple[Hull, Vehicle]:
    """Return a hull and the vehicle file of its owner; of a shipped vehicle, a hull with the model's equations."""
    if name in FOREIGN:
        return FOREIGN[name](), Vehicle.load(str(HERE / f"{name}.toml"))
    if name.startswith(drawn.NAME):
        true, file = drawn.vehicles(int(name.removeprefix(drawn.NAME)))
        return model_hull(true), file
    vehicle = Vehicle.load(name)
    return model_hull(vehicle), vehicle


def model_hull(vehicle: Vehicle) -> Hull:
    """Return the controller's own equations with the parameters of a vehicle file, as a hull.

    M nu' + C(nu) nu = f with a diagonal M of surge, sway and yaw is the model of ``vehicle/template.toml``. The thrust
    itself follows the command with the lag. Heave, roll and pitch are not excited.
    """
    surge, sway, yaw, port = vehicle.surge, vehicle.sway, vehicle.yaw, vehicle.thrusters[0]
    return Hull(
        name=vehicle.name,
        M=np.diag([surge.mass_kg, sway.mass_kg, sway.mass_kg, 1.0, 1.0, yaw.inertia_kgm2]),
        D=np.diag([surge.linear_damping_kgps, sway.linear_damping_kgps, 1.0, 1.0, 1.0, yaw.linear_damping_Nms]),
        quadratic=np.array(
            [
                surge.quadratic_damping_kgpm,
                sway.quadratic_damping_kgpm,
                0.0,
                0.0,
                0.0,
                yaw.quadratic_damping_kgm2,
            ]
        ),
        centre_of_gravity=(0.0, 0.0, 0.0),
        max_N=port.max_N,
        min_N=port.min_N,
        arms_m=(port.arm_m, vehicle.thrusters[1].arm_m),
        lag_s=port.lag_s,
        lag_of_revolutions=False,
    )


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """What stands between the hull and its pilot."""

    reports_s: float = math.inf  # time at which the reports of the actuators stop; 0: there are none
    offset_m: Pair = (0.0, 0.0)  # estimated point, ahead and to starboard of the centre of gravity; no file declares it
    noise_m: float = 0.0  # white noise of each estimated position, north and east; no covariance
    period_s: float = 0.1  # of the estimates
    latency_s: float = 0.0  # age of an estimate when it arrives
    jitter_s: float = 0.0  # by which that age is more or less, at random
    stamped_at_arrival: bool = False  # instead of when the state was true
    current_mps: float = 0.0  # of the water, which no estimate contains
    side_force: float = 0.0  # of a steady wind, as a share of the largest thrust of both thrusters
    released_s: Pair = (
        math.inf,
        math.inf,
    )  # between these times the thrusters rest whatever the plan is, and report it
    mismatch: Mismatch = AS_IN_FILE  # of the hull and its numbers: factors, and a lag to add
    actuators: Actuators = DIRECT
    water: Water = STILL  # added to the current, at the surface
    gusts: Wind = CALM  # added to the side force


class Start(NamedTuple):
    """Position and heading of the hull, directions of current and wind, and the seed of the noise."""

    position_m: Pair = (0.0, 0.0)
    heading_rad: float = 0.0
    current_rad: float = 0.0
    wind_rad: float = 0.0
    seed: int = 0

    @classmethod
    def drawn(cls, seed: int, within_m: float = 0.6) -> Start:
        """Return a random start within a distance of the origin."""
        radius, *angles = np.random.default_rng(seed).random(5).tolist()
        radius = within_m * math.sqrt(radius)
        bearing, heading, current, wind = (2 * math.pi * angle for angle in angles)
        return cls((radius * math.cos(bearing), radius * math.sin(bearing)), heading, current, wind, seed)


class Pilot(Protocol):
    """Source of thrusts: this project's controller, or a rival."""

    cycle_steps: int
    delay_steps: int
    """From the start of a cycle to the arrival of its plan."""

    @property
    def nominal(self) -> bool:
        """False if its last plan reported trouble."""
        ...

    def plan(self, estimate: Estimate, t_ns: int, applied: Applied | None) -> tuple[npt.NDArray[np.int64], Array]:
        """Return knots (N,) in ns, and the thrusts (N, 2) of port and starboard at them."""
        ...


class Ours:
    """The controller of this project, through ``ltv_mpc.Controller``."""

    cycle_steps, delay_steps = 30, 10

    def __init__(self, vehicle: Vehicle, reference: Reference, config: ControllerConfig | None = None) -> None:
        self.controller = Controller(vehicle, reference, config)
        self.nominal = False

    def plan(self, estimate: Estimate, t_ns: int, applied: Applied | None) -> tuple[npt.NDArray[np.int64], Array]:
        """Return the plan of one cycle."""
        plan = self.controller.plan(estimate, t_ns=t_ns, applied=applied)
        self.nominal = plan.health is Health.NOMINAL
        return plan.t_ns, plan.thrust_N[:, :2]


class Flight(NamedTuple):
    """What a flight was like, each 10 ms."""

    t_s: Array  # (M,)
    track: Array  # (M, 8) of the centre of gravity, as ``Plant.run`` gives it
    point: Array  # (M, 2) true position of the estimated point
    command_N: Array  # (M, 2)
    nominal: npt.NDArray[np.bool_]  # (M,)
    needed_N: float  # drag of the current's speed ahead, for each thruster

    def turned_deg(self, begin_s: float, end_s: float) -> float:
        """Return the range of the unwrapped heading between two times."""
        return float(np.degrees(np.ptp(self.track[self.between(begin_s, end_s), HEADING])))

    def mean_N(self, begin_s: float, end_s: float) -> float:
        """Return the mean of the absolute delivered thrust of a thruster between two times."""
        return float(np.abs(self.track[self.between(begin_s, end_s), PORT:]).mean())

    def distance_m(self, target_m: Pair, begin_s: float, end_s: float) -> Array:
        """Return the distance of the estimated point from a target between two times."""
        distance: Array = np.hypot(*(self.point[self.between(begin_s, end_s)] - target_m).T)
        return distance

    def between(self, begin_s: float, end_s: float) -> npt.NDArray[np.bool_]:
        """Return the mask (M,) of the times between two."""
        mask: npt.NDArray[np.bool_] = (self.t_s >= begin_s) & (self.t_s < end_s)
        return mask


def fly(
    name: str,
    pilot: Pilot,
    conditions: Conditions = Conditions(),
    start: Start = Start(),  # noqa: B008
    *,
    duration_s: float = 180.0,
) -> Flight:
    """Fly one hull.

    Parameters
    ----------
    name : of the hull, a key of ``FOREIGN`` or an entry of ``SHIPPED``.
    pilot : what steers it.
    conditions, start : see there.
    duration_s : length of the flight.
    """
    hull, vehicle = load(name)
    steady = _vector(conditions.current_mps, start.current_rad)
    wind_N = _vector(2 * conditions.side_force * hull.max_N, start.wind_rad)
    plant = Plant(
        _true_hull(hull, conditions.mismatch),
        position_m=start.position_m,
        heading_rad=start.heading_rad,
        current_mps=steady,
        force_N=wind_N,
        shares=conditions.mismatch.thrusts[:2],
    )
    path, gusts = CommandPath(conditions.actuators), WindForce(conditions.gusts, start.seed)
    column = make(conditions.water, start.seed)
    varies = gusts.blows or conditions.water != STILL
    rng = np.random.default_rng([7, start.seed])
    thrusters = _Thrusters(vehicle)
    period = round(conditions.period_s / STEP_S)
    waiting: list[tuple[int, Estimate]] = []  # with the time of the arrival (ns)
    newest: Estimate | None = None
    state = np.array([*start.position_m, start.heading_rad, 0.0, 0.0, 0.0, 0.0, 0.0])
    tracks, commands, nominal = [], [], []
    for k in range(0, round(duration_s / STEP_S), CHUNK):
        t_ns, t_s = k * STEP_NS, k * STEP_S
        if k % period == 0:
            age_s = conditions.latency_s + (
                conditions.jitter_s * rng.uniform(-1.0, 1.0) if conditions.jitter_s else 0.0
            )
            made = _estimate(t_ns, state, conditions, rng, dives=vehicle.can_dive)
            waiting.append((t_ns + round(age_s * 1e9), made))
            waiting.sort(key=itemgetter(0))
        while waiting and waiting[0][0] <= t_ns:
            arrival_ns, made = waiting.pop(0)
            if conditions.stamped_at_arrival:
                newest = msgspec.structs.replace(made, t_ns=arrival_ns)
            elif newest is None or made.t_ns > newest.t_ns:
                newest = made
        thrusters.receive(t_ns)
        if k % pilot.cycle_steps == 0 and newest is not None:
            applied = thrusters.report(t_ns, state) if t_s < conditions.reports_s else None
            thrusters.send(t_ns, t_ns + pilot.delay_steps * STEP_NS, *pilot.plan(newest, t_ns, applied))
            thrusters.receive(t_ns)
        released = conditions.released_s[0] <= t_s < conditions.released_s[1]
        command = thrusters.commands(t_ns, rest=released)
        if varies:
            middle_ns = t_ns + CHUNK * STEP_NS // 2
            water, gust = column.at(0.0, middle_ns), gusts.force_N(middle_ns, 0.0)
            plant.set_outside((steady[0] + water[0], steady[1] + water[1]), (wind_N[0] + gust[0], wind_N[1] + gust[1]))
        times_ns = range(t_ns, t_ns + CHUNK * STEP_NS + 1, STEP_NS)
        track = plant.run(path.followed(times_ns, command)[:, :2], STEP_S)
        state = track[-1]
        tracks.append(track)
        commands.append(command)
        nominal.append(pilot.nominal)
    track = np.concatenate(tracks)
    cos, sin, (ahead, aside) = np.cos(track[:, HEADING]), np.sin(track[:, HEADING]), conditions.offset_m
    return Flight(
        t_s=STEP_S * np.arange(1, len(track) + 1),
        track=track,
        point=track[:, :2] + np.stack([cos * ahead - sin * aside, sin * ahead + cos * aside], axis=1),
        command_N=np.concatenate(commands)[:, :2],
        nominal=np.repeat(np.array(nominal), CHUNK),
        needed_N=0.5 * hull.drag_N(conditions.current_mps),
    )


def _true_hull(hull: Hull, mismatch: Mismatch) -> Hull:
    """Return the hull with masses, drag, arms and lag of the mismatch; factors on thrust are shares of the plant."""
    if mismatch == AS_IN_FILE:
        return hull
    drag, arms = mismatch.drag, (mismatch.port_arm * hull.arms_m[0], mismatch.starboard_arm * hull.arms_m[1])
    return replace(
        hull,
        M=mismatch.mass * hull.M,
        cancelled_munk_kg=mismatch.mass * hull.cancelled_munk_kg,
        D=drag * hull.D,
        quadratic=drag * hull.quadratic,
        across=hull.across * [1.0, drag],
        along=hull.along * [1.0, drag],
        fin_kgpm=drag * hull.fin_kgpm,
        arms_m=arms,
        lag_s=mismatch.lag * hull.lag_s + mismatch.extra_lag_s,
    )


def _vector(length: float, direction_rad: float) -> Pair:
    return length * math.cos(direction_rad), length * math.sin(direction_rad)


def _estimate(t_ns: int, state: Array, conditions: Conditions, rng: np.random.Generator, *, dives: bool) -> Estimate:
    """Return the estimate of the point that the navigation gives."""
    north, east, psi, velocity_north, velocity_east, r = state[:6].tolist()
    c, s, (ahead, aside) = math.cos(psi), math.sin(psi), conditions.offset_m
    arm_north, arm_east = c * ahead - s * aside, s * ahead + c * aside
    noise = (conditions.noise_m * rng.standard_normal(2)).tolist() if conditions.noise_m else (0.0, 0.0)
    return Estimate(
        t_ns=t_ns,
        north_m=north + arm_north + noise[0],
        east_m=east + arm_east + noise[1],
        heading_rad=math.remainder(psi, 2 * math.pi),
        yaw_rate_radps=r,
        velocity_north_mps=velocity_north - r * arm_east,
        velocity_east_mps=velocity_east + r * arm_north,
        depth_m=0.0 if dives else None,
    )


class _Thrusters:
    """Actuators: the newest plan that has begun is followed, within the slew."""

    def __init__(self, vehicle: Vehicle) -> None:
        thrusters = vehicle.thrusters[:2]
        self._reach = [STEP_S * t.slew_N_per_s for t in thrusters]
        self._limits = [(t.min_N, t.max_N) for t in thrusters]
        self._knots: tuple[Array, Array] = np.array([0.0]), np.zeros((1, 2))
        self._sent: list[tuple[int, int, npt.NDArray[np.int64], Array]] = []
        self._command = [0.0, 0.0]
        self._sequence, self._cycle_ns, self._received_ns, self._late, self._all_late = -1, 0, 0, False, 0

    def send(self, t_ns: int, arrival_ns: int, knots_ns: npt.NDArray[np.int64], thrust_N: Array) -> None:
        """Put a plan on its way."""
        self._sent.append((t_ns, arrival_ns, knots_ns, thrust_N))

    def receive(self, t_ns: int) -> None:
        """Replace the plan in force from the first knot of the plan that has arrived."""
        while self._sent and self._sent[0][1] <= t_ns:
            self._cycle_ns, _, knots, thrust = self._sent.pop(0)
            self._sequence, self._received_ns, self._late = self._sequence + 1, t_ns, t_ns > knots[0]
            self._all_late += self._late
            old_t, old = self._knots
            keep = old_t < knots[0]
            if keep.any():  # the old plan up to the instant before the new one
                cut = float(knots[0]) - 1.0
                last = np.array([np.interp(cut, old_t, old[:, i]) for i in range(2)])
                old_t, old = np.append(old_t[keep], cut), np.vstack([old[keep], last])
                after = max(int(np.searchsorted(old_t, t_ns)) - 1, 0)
                self._knots = np.concatenate([old_t[after:], knots]), np.vstack([old[after:], thrust])
            else:
                self._knots = knots.astype(float), thrust

    def commands(self, t_ns: int, *, rest: bool) -> Array:
        """Return the commands (CHUNK, 3) of the next steps; there is no third thruster."""
        out = np.zeros((CHUNK, 3))
        if not rest:
            times = t_ns + STEP_NS * np.arange(1, CHUNK + 1)
            for i in range(2):
                out[:, i] = np.interp(times, self._knots[0], self._knots[1][:, i])
        for i in range(2):
            y, reach, (low, high) = self._command[i], self._reach[i], self._limits[i]
            for j, wanted in enumerate(out[:, i].tolist()):
                y = min(max(y + min(max(wanted - y, -reach), reach), low), high)
                out[j, i] = y
            self._command[i] = y
        return out

    def report(self, t_ns: int, state: Array) -> Applied:
        """Return the actuators' report."""
        return Applied(
            t_ns=t_ns,
            thrust_N=(float(state[PORT]), float(state[STARBOARD]), 0.0),
            command_N=(*self._command, 0.0),
            command_slew_N_per_s=(0.0, 0.0, 0.0),
            plan_epoch=0 if self._sequence < 0 else 1,
            plan_sequence=self._sequence,
            plan_cycle_t_ns=self._cycle_ns,
            plan_received_t_ns=self._received_ns,
            plan_late=self._late,
            plans_late=self._all_late,
            plans_rejected=0,
        )
