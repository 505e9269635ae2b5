"""Plant: the true vehicle in the true water, with the plan gate of its actuators.

Before t = 0 the vehicle is afloat: thrust is zero, depth is held, and it drifts with the water at the surface. From
t = 0 it follows the plans that the gate accepts. With its first step the plant arms the controller, as an operator
would. The simulation's step lasts 10 ms, and the command is linear over it; a step of the node has five of them. The
plant has no sea bed: a vehicle that goes below the water's ``bottom_m`` continues to sink, and the sensors find no bed
there.

A ``Disturbance`` and the wind act through their impulse, half of it before and half after each step (Strang splitting,
an error of order h^2 of what it adds). Without them every step is bit for bit the undisturbed one.

The slew limit holds for the commands. The delivered thrust has a rate of change of its own: a propeller with a lag in
revolutions, a dead zone or another lag than the file's may change its thrust faster than the commands change.

On its path to the propellers' governors a command meets dead time, quantisation and dead zone:

    y_q(t) = q round(y(t - dead time) / q),  0 where |y_q| < dead zone

A motor driver rounds its pulse width to steps, and does not start its motor below a least one: the motor stands still,
then jumps to its least speed. Gate and report of the actuators know the command y alone. The path of each thruster is
the same.

The wind is a steady force on the vehicle in the earth frame, with gusts along it:

    f(t) = [cos direction, sin direction] (force + gust sqrt(2 / K) sum_k sin(2 pi f_k t + p_k))

The K frequencies f_k (Hz) lie at equal ratios over two decades about 1 / period, each with the same share of the mean
square, and the phases p_k are uniform: f S(f) is flat, as in the middle of the spectra of gusts (Fossen 2021, section
10.1). It is a pure function of seed and time. No wind acts below the surface, and none turns the vehicle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise, takewhile

import numpy as np

from ltv_mpc.frames import wrap_angle
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Action, Applied, Array, Command, Disturbance, Message, Pair, Plan, Times, Triple, Truth
from ltv_mpc.node import Grid, Inbox
from ltv_mpc.safety.plan_gate import PlanGate
from ltv_mpc.vehicle.parameters import Vehicle
from sim import motion
from sim.attitude import Attitude, TiltWaves, roll_and_pitch
from sim.motion import MotionState
from sim.random_streams import Stream, generator
from sim.scenario import SURFACED_M, Actuators, Scenario
from sim.scenario import Wind as Settings
from sim.water import WaterColumn
from sim.water.column import SAMPLE_PERIOD_NS, WaterSample, WaterWindow, water_at

PERIOD_NS = 50_000_000
"""Time between two steps of the node, because a wake-up costs more than a step of the simulation."""
STEP_NS = 10_000_000
"""Step of the simulation, and time between two truths."""
REPORT_NS = 100_000_000
"""Time between two periodic reports of the actuators; each received message is also reported at once."""

NO_DISTURBANCE = Disturbance(end_t_ns=0)

ARMING = 1
"""Identifier of the only command that the plant sends."""


class Plant:
    """Node that simulates the vehicle and its actuators.

    It reads ``Plan`` and ``Disturbance``. It writes ``Truth`` each 10 ms, ``Applied`` each 100 ms and with each
    received message, and the arming ``Command`` once, unless the scenario leaves arming to an operator.
    """

    name = "plant"
    schedule = Grid(PERIOD_NS)
    reads: tuple[type[Message], ...] = (Plan, Disturbance)
    writes: tuple[type[Message], ...] = (Truth, Applied, Command)

    def __init__(self, scenario: Scenario, vehicle: Vehicle, water: WaterColumn) -> None:
        """Build the true vehicle: ``vehicle``, the controller's model, changed by the scenario's mismatch."""
        start = scenario.plant
        self._arms = scenario.run.arm
        self._water = water
        self._attitude = Attitude(start.tilt_rms_rad, start.tilt_period_s, scenario.run.seed)
        self._body = motion.pack(vehicle, start.mismatch)
        self._coefficients, self._factors = motion.unpack(self._body).p, start.mismatch.thrusts
        self._path, self._wind = CommandPath(start.actuators), Wind(start.wind, scenario.run.seed)
        s = np.array([start.north_m, start.east_m, 0.0, 0.0, start.heading_rad, 0.0, start.depth_m, 0.0])
        self._vehicle = MotionState(s, n=np.zeros(3), F=np.zeros(3))
        self._command, self._followed = np.zeros(3), np.zeros(3)  # the last command, and the one that is followed (N)
        self._slew = np.zeros(3)  # largest rate of change of the command since the last report (N/s)
        self._t_ns: int | None = None
        self._disturbance: Disturbance | None = None
        self._gate = PlanGate(vehicle)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        """Simulate to ``t_ns`` in steps of ``STEP_NS``, each with the messages that have arrived by its end.

        Steps without a message, up to a whole second of the water's samples, are computed in one call.
        """
        times_ns = [t_ns] if self._t_ns is None else [*range(self._t_ns + STEP_NS, t_ns, STEP_NS), t_ns]
        waiting = list(inbox)
        outputs: list[Message] = []
        while times_ns:
            arrived = takewhile(lambda received: received.received_t_ns <= times_ns[0], waiting)
            here = waiting if len(times_ns) == 1 else list(arrived)
            waiting = waiting[len(here) :]
            count = 1 if here or self._is_pushed or self._t_ns is None else _steps_at_once(times_ns, waiting)
            outputs += self._advance(times_ns[:count], here)
            del times_ns[:count]
        return outputs

    @property
    def _is_pushed(self) -> bool:
        return self._disturbance is not None or self._wind.blows

    def _advance(self, times_ns: list[int], inbox: Inbox) -> list[Message]:
        """Take one step with its inbox, or several without an inbox (``_steps_at_once``)."""
        t_ns = times_ns[0]
        from_ns = t_ns if self._t_ns is None else self._t_ns
        at_ns = from_ns
        for received in inbox:
            if isinstance(received.message, Plan):
                # A plan acts from its arrival on, which may lie within the step.
                at_ns = min(max(received.received_t_ns, at_ns), t_ns)
                self._gate.command_at(max(at_ns, 0))
                self._gate.offer(received.message, received.epoch, received.sequence, received.received_t_ns)
        observed = self._move([from_ns, *times_ns]) if t_ns > from_ns else self._observe(t_ns)
        for received in inbox:
            if isinstance(received.message, Disturbance):  # it acts from the next step on
                self._disturbance = received.message
        self._t_ns = times_ns[-1]
        outputs: list[Message] = [self._truth(t, row) for t, row in zip(times_ns, observed.tolist(), strict=True)]
        if self._arms:
            self._arms = False
            outputs.append(Command(command_id=ARMING, action=Action.ARM, force=True))
        if inbox or self._t_ns % REPORT_NS == 0:
            outputs.append(self._report(self._t_ns))
        return outputs

    def _move(self, times_ns: list[int]) -> Array:
        """Simulate from the first of these times; return the observations at the others, (K, 18)."""
        commands = np.array([self._command, *(self._gate.command_at(max(t, 0)) for t in times_ns[1:])])
        t_ns = np.array(times_ns)
        rates = np.abs(commands[1:] - commands[:-1]) / ((t_ns[1:] - t_ns[:-1]) * 1e-9)[:, None]
        self._slew = np.maximum(self._slew, rates.max(axis=0))
        self._command, commands = commands[-1], commands[1:]
        half_s = 0.5 * ((times_ns[1] - times_ns[0]) * 1e-9)
        if self._disturbance is not None and self._disturbance.end_t_ns <= times_ns[0]:
            self._disturbance = None
        afloat, is_pushed = times_ns[1] <= 0, self._is_pushed
        if is_pushed:
            self._push(times_ns[0], half_s, afloat)
        observed = simulate_steps(
            self._body,
            (*self._vehicle,),
            self._followed,
            self._path.followed(times_ns, commands),
            t_ns,
            self._water.window([(a + b) // 2 for a, b in pairwise(times_ns)]),
            self._water.window(times_ns[1:]),
            (*self._attitude.tilt,),
        )
        if not is_pushed:
            return observed
        self._push(times_ns[1], half_s, afloat)
        return self._observe(times_ns[1])

    def _push(self, t_ns: int, seconds: float, afloat: bool) -> None:
        """Add the impulse of ``seconds`` to u, v, r and w; afloat the depth is held, and w with it."""
        p, state, f = self._coefficients, self._vehicle.s, self._disturbance or NO_DISTURBANCE
        lost = (np.array(self._factors) * (np.array(f.thrust_scale) - 1.0) * self._vehicle.F).tolist()
        wind = self._wind.force_N(t_ns, state[6])
        north, east = f.force_N[0] + wind[0], f.force_N[1] + wind[1]
        cos, sin = math.cos(state[4]), math.sin(state[4])
        ahead, to_starboard = cos * north + sin * east, cos * east - sin * north
        yaw_Nm = lost[0] * p.arm_port - lost[1] * p.arm_starboard + f.yaw_moment_Nm
        # M_x u' = F1 + F2 + f_x,  M_y v' = f_y,  I_z r' = F1 a1 - F2 a2 + m,  M_z w' = F3 + f_z
        state[2] += seconds * (lost[0] + lost[1] + ahead) / p.mass_surge
        state[3] += seconds * to_starboard / p.mass_sway
        state[5] += seconds * yaw_Nm / p.inertia_yaw
        if not afloat:
            state[7] += seconds * (lost[2] + f.force_N[2]) / p.mass_heave

    def _observe(self, t_ns: int) -> Array:
        """Return the observation at ``t_ns``, (1, 18)."""
        observed = np.empty((1, 18))
        observe(observed[0], self._vehicle, self._factors, t_ns * 1e-9, self._attitude.tilt, self._water.sample(t_ns))
        return observed

    def _truth(self, t_ns: int, observed: list[float]) -> Truth:
        n, e, u, v, _, r, z, w, vn, ve, roll, pitch, heading, cn, ce, port, starboard, vertical = observed
        if self._disturbance is not None:
            p, s, d = self._disturbance.thrust_scale
            port, starboard, vertical = port * p, starboard * s, vertical * d
        return Truth(
            t_ns=t_ns,
            position_m=(n, e, z),
            velocity_mps=(vn, ve, w),
            attitude_rad=(roll, pitch, heading),
            water_velocity_mps=(u, v, w),
            yaw_rate_radps=r,
            current_mps=(cn, ce),
            thrust_N=(port, starboard, vertical),
        )

    def _report(self, t_ns: int) -> Applied:
        slew = _triple(self._slew)
        self._slew = np.zeros(3)
        rejected = self._gate.plans_rejected
        return self._gate.applied(t_ns, self._vehicle.F, self._command, slew_N_per_s=slew, rejected=rejected)


def _steps_at_once(times_ns: Sequence[int], waiting: Inbox) -> int:
    """Return the number of steps to the next report, message, or whole second of the water's samples."""
    last = len(times_ns) - 1
    for k in range(1, last + 1):
        arrives = bool(waiting) and (k == last or waiting[0].received_t_ns <= times_ns[k])
        if arrives or times_ns[k - 1] % REPORT_NS == 0 or times_ns[k] % SAMPLE_PERIOD_NS == 0:
            return k
    return last + 1


@jit
def simulate_steps(
    flat: Array,
    vehicle: tuple[Array, Array, Array],
    last: Array,
    commands: Array,
    t_ns: Times,
    water: WaterWindow,
    observed_water: WaterWindow,
    tilt: tuple[float, Array],
) -> Array:
    """Take K steps with ``motion.step`` and return the observation after each, (K, 18), as ``observe`` gives it.

    Parameters
    ----------
    flat : the true vehicle, from ``motion.pack``.
    vehicle : fields of ``MotionState`` at t_ns[0]; those at t_ns[K] afterwards. Tuples here are plain, because named
        ones make a call slower (docs/notes/kernel-arguments.md).
    last : (3,) thrust (N) that the governors follow at t_ns[0]; that at t_ns[K] afterwards.
    commands : (K, 3) thrust (N) that they follow at the end of each step.
    t_ns : (K+1,) vehicle time (ns) of the start and of the end of each step.
    water : the water column in the middle of each step.
    observed_water : the water column at the end of each step.
    tilt : fields of ``TiltWaves``.
    """
    factors = motion.unpack(flat).factors
    state, waves = MotionState(*vehicle), TiltWaves(*tilt)
    depth_m, earlier, later, time_weights, wave = water
    end_depth_m, end_earlier, end_later, end_time_weights, end_wave = observed_water
    observed = np.empty((len(commands), 18))
    for k in range(len(commands)):
        h = (t_ns[k + 1] - t_ns[k]) * 1e-9
        at_middle = WaterSample(depth_m, earlier, later, time_weights[k], (wave[k, 0], wave[k, 1], wave[k, 2]))
        motion.step(flat, state, last, commands[k], t_ns[k + 1] <= 0, h, at_middle)
        copy_to(last, commands[k])
        end_waves = end_wave[k, 0], end_wave[k, 1], end_wave[k, 2]
        at_end = WaterSample(end_depth_m, end_earlier, end_later, end_time_weights[k], end_waves)
        observe(observed[k], state, factors, t_ns[k + 1] * 1e-9, waves, at_end)
    return observed


@jit
def observe(out: Array, vehicle: MotionState, factors: Triple, t: float, tilt: TiltWaves, water: WaterSample) -> None:
    """Write the observation at vehicle time ``t`` (s) to ``out`` (18,).

    It holds the state (8), velocity over ground north and east, roll, pitch, heading, current north and east, and
    the delivered thrust (3): ``factors`` times that of eq 8.
    """
    s = vehicle.s
    copy_to(out[:8], s)
    cn, ce, _, _ = water_at(s[6], water)
    # [n', e'] = R(psi) [u, v] + c(z)
    cos, sin = math.cos(s[4]), math.sin(s[4])
    out[8], out[9] = cos * s[2] - sin * s[3] + cn, sin * s[2] + cos * s[3] + ce
    out[10], out[11] = roll_and_pitch(t, tilt)
    out[12] = wrap_angle(s[4])
    out[13], out[14] = cn, ce
    for i in range(3):
        out[15 + i] = factors[i] * vehicle.F[i]


def _triple(a: Array) -> Triple:
    x, y, z = a.tolist()
    return x, y, z


class CommandPath:
    """Commands on their way to the propellers."""

    def __init__(self, settings: Actuators) -> None:
        self._settings = settings
        self._dead_ns = round(settings.dead_time_s * 1e9)
        self._t_ns, self._sent = np.empty(0), np.zeros((1, 3))  # what is still needed of the commands

    def followed(self, t_ns: Sequence[int], commands: Array) -> Array:
        """Return what the governors follow at t_ns[1:], (K, 3) in N.

        Parameters
        ----------
        t_ns : (K+1,) vehicle time (ns); the first is the last one of the call before.
        commands : (K, 3) commands (N) at t_ns[1:], linear between them.
        """
        if self._settings == Actuators():
            return commands
        out = commands
        if self._dead_ns:
            self._t_ns = np.append(self._t_ns if len(self._t_ns) else t_ns[0], t_ns[1:]).astype(np.float64)
            self._sent = np.vstack([self._sent, commands])
            at = np.array(t_ns[1:], dtype=np.float64) - self._dead_ns
            out = np.column_stack([np.interp(at, self._t_ns, sent) for sent in self._sent.T])
            gone = max(int(np.searchsorted(self._t_ns, at[-1])) - 1, 0)
            self._t_ns, self._sent = self._t_ns[gone:], self._sent[gone:]
        if quantum := self._settings.quantum_N:
            out = quantum * np.round(out / quantum)
        return np.where(np.abs(out) < self._settings.dead_zone_N, 0.0, out)


SINES = 16


class Wind:
    """Force of the wind in one run, from the settings' table [plant.wind]."""

    def __init__(self, settings: Settings, seed: int) -> None:
        """Take the settings and draw the phases of the gusts."""
        self.blows = max(settings.force_N, settings.gust_N) > 0.0
        self._settings = settings
        self._rates = 2.0 * math.pi / settings.gust_period_s * np.geomspace(0.1, 10.0, SINES)
        self._phases = generator(seed, Stream.WIND).uniform(0.0, 2.0 * math.pi, SINES)

    def force_N(self, t_ns: int, depth_m: float) -> Pair:
        """Return the force north and east at a time and a depth."""
        if not self.blows or depth_m >= SURFACED_M:
            return 0.0, 0.0
        gust = math.sqrt(2.0 / SINES) * float(np.sin(self._rates * (t_ns * 1e-9) + self._phases).sum())
        force = self._settings.force_N + self._settings.gust_N * gust
        return force * math.cos(self._settings.direction_rad), force * math.sin(self._settings.direction_rad)
