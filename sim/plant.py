"""The plant: the true vehicle in the true water, with its actuators' gate.

Before t = 0 it is afloat: thrusts zero, its depth kept, drifting with the surface's water. From then on it follows the
plans that its gate lets through. With its first step it arms the controller, as an operator would. Steps of 10 ms; the
command is linear over a step. It knows no sea bed: a vehicle that goes deeper than the water's ``bottom_m`` goes on
below it, where the sensors find no bed.

A ``Disturbance`` acts by its impulse, half of it before each step and half after (Strang's splitting, of the order h^2
of what it adds); without one no bit of a step is another than if there were none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from ltv_mpc.frames import wrap_angle
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Action, Applied, Array, Command, Disturbance, Message, Plan, Triple, Truth
from ltv_mpc.node import Due, Grid, Inbox, ReceivedMessage
from ltv_mpc.safety.plan_gate import PlanGate, PlanVerdict
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from sim import motion
from sim.attitude import Attitude, sum_of_sines
from sim.scenario import Mismatch, Scenario
from sim.water import WaterColumn
from sim.water.column import KNOT_NS, velocity_at

PERIOD_NS = 10_000_000
REPORT_NS = 100_000_000
"""Time between two reports of the actuators; a plan that arrives is answered at once besides."""


ARMING = 1
"""The number of the one command that it gives."""


class Plant:
    """Reads ``Plan`` and ``Disturbance``; writes ``Truth`` each step, ``Applied`` each 100 ms and with each message
    that arrives, and once the ``Command`` that arms, unless the scenario leaves that to someone else.
    """

    name = "plant"
    schedule = Grid(PERIOD_NS)
    reads: tuple[type[Message], ...] = (Plan, Disturbance)
    writes: tuple[type[Message], ...] = (Truth, Applied, Command)

    def __init__(self, scenario: Scenario, vehicle: Vehicle, water: WaterColumn) -> None:
        """``vehicle`` is the controller's model; the scenario's mismatch makes the true one of it."""
        start = scenario.plant
        self._arms = scenario.run.arm
        self._water = water
        self._attitude = Attitude(start.tilt_rms_rad, start.tilt_period_s, scenario.run.seed)
        self._coefficients, self._factor = apply_mismatch(vehicle.coefficients(), start.mismatch), start.mismatch.thrust
        self._body = motion.pack(vehicle, self._coefficients, self._factor)
        self._state = np.array([start.north_m, start.east_m, 0.0, 0.0, start.heading_rad, 0.0, start.depth_m, 0.0])
        self._revolutions, self._thrust = np.zeros(3), np.zeros(3)
        self._command: Triple = (0.0, 0.0, 0.0)
        self._commands = np.zeros((2, 3))  # at the last step, and how fast it has changed at most since the last report
        self._t_ns: int | None = None
        self._disturbance: Disturbance | None = None
        self._gate = PlanGate(vehicle)
        self._receipt: tuple[Plan, ReceivedMessage, PlanVerdict] | None = None  # of the plan accepted last

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """The vehicle at each time, after what arrived up to then; between two reports of the actuators at once."""
        signals: list[list[Message]] = []
        while len(signals) < len(due):
            first = len(signals)
            end = first + 1
            if self._t_ns is not None and self._disturbance is None and not due[first][1]:
                while end < len(due) and not due[end][1] and _can_continue(due[end - 1][0], due[end][0]):
                    end += 1
            signals += self._go([t_ns for t_ns, _ in due[first:end]], due[first][1])
        return signals

    def _go(self, times_ns: list[int], inbox: Inbox) -> list[list[Message]]:
        """Take one step with its inbox, or several without one, each of which passes ``_can_continue``."""
        t_ns = times_ns[0]
        from_ns = t_ns if self._t_ns is None else self._t_ns
        at_ns = from_ns
        for arrival in inbox:
            if isinstance(arrival.message, Plan):
                # A plan acts from its arrival on, wherever in the step that is.
                at_ns = min(max(arrival.received_t_ns, at_ns), t_ns)
                self._gate.command_at(max(at_ns, 0))
                verdict = self._gate.offer(arrival.message, arrival.epoch, arrival.sequence, arrival.received_t_ns)
                if verdict in (PlanVerdict.ACCEPTED, PlanVerdict.LATE):
                    self._receipt = arrival.message, arrival, verdict
        seen = self._move([from_ns, *times_ns]) if t_ns > from_ns else self._observe(t_ns)
        for arrival in inbox:
            if isinstance(arrival.message, Disturbance):  # it acts from the next step on
                self._disturbance = arrival.message
        self._t_ns = times_ns[-1]
        signals: list[list[Message]] = [[self._truth(t, row)] for t, row in zip(times_ns, seen.tolist(), strict=True)]
        if self._arms:
            self._arms = False
            signals[-1].append(Command(command_id=ARMING, action=Action.ARM))
        if inbox or self._t_ns % REPORT_NS == 0:
            signals[-1].append(self._report(self._t_ns))
        return signals

    def _move(self, times_ns: list[int]) -> Array:
        """From the first of these times on; what is seen of it at the others, (K, 18)."""
        t_ns = np.array(times_ns)
        commands = self._gate.commands_at([max(t, 0) for t in times_ns[1:]])
        port, starboard, vertical = commands[-1].tolist()
        self._command = port, starboard, vertical
        seconds = (t_ns[1:] - t_ns[:-1]) * 1e-9
        disturbance = self._disturbance
        if disturbance is not None and disturbance.end_t_ns <= times_ns[0]:
            disturbance = self._disturbance = None
        afloat = times_ns[1] <= 0
        if disturbance is not None:
            self._push(disturbance, 0.5 * seconds[0], afloat)
        water, attitude = self._water, self._attitude
        seen = simulate_steps(
            self._body,
            self._state,
            self._revolutions,
            self._thrust,
            self._commands,
            commands,
            t_ns[1:],
            seconds,
            water.depth_m,
            *water.throughout([(a + b) // 2 for a, b in pairwise(times_ns)]),
            *water.throughout(times_ns[1:]),
            self._factor,
            attitude.waves,
            attitude.amplitude_rad,
        )
        if disturbance is None:
            return seen
        self._push(disturbance, 0.5 * seconds[0], afloat)
        return self._observe(times_ns[1])

    def _push(self, disturbance: Disturbance, seconds: float, afloat: bool) -> None:
        """The impulse of ``seconds`` on u, v, r and w; afloat the depth is kept, and with it w."""
        p, state, f = self._coefficients, self._state, disturbance
        lost = (self._factor * (np.array(f.thrust_scale) - 1.0) * self._thrust).tolist()
        cos, sin = math.cos(state[4]), math.sin(state[4])
        ahead, to_starboard = cos * f.force_N[0] + sin * f.force_N[1], cos * f.force_N[1] - sin * f.force_N[0]
        yaw_Nm = lost[0] * p.arm_port - lost[1] * p.arm_starboard + f.yaw_moment_Nm
        # M_x u' = F1 + F2 + f_x,  M_y v' = f_y,  I_z r' = F1 a1 - F2 a2 + m,  M_z w' = F3 + f_z
        state[2] += seconds * (lost[0] + lost[1] + ahead) / p.mass_surge
        state[3] += seconds * to_starboard / p.mass_sway
        state[5] += seconds * yaw_Nm / p.inertia_yaw
        if not afloat:
            state[7] += seconds * (lost[2] + f.force_N[2]) / p.mass_heave

    def _observe(self, t_ns: int) -> Array:
        """What is seen of it at ``t_ns``, (1, 18)."""
        seen, attitude, water = np.empty((1, 18)), self._attitude, self._water
        observe(
            seen[0],
            self._state,
            self._thrust,
            self._factor,
            attitude.waves,
            attitude.amplitude_rad,
            t_ns * 1e-9,
            water.depth_m,
            *water.between(t_ns),
        )
        return seen

    def _truth(self, t_ns: int, seen: list[float]) -> Truth:
        n, e, u, v, _, r, z, w, vn, ve, roll, pitch, heading, cn, ce, port, starboard, vertical = seen
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
        slew = _triple(self._commands[1])
        self._commands[1] = 0.0
        plan, arrival, verdict = self._receipt or (None, None, PlanVerdict.ACCEPTED)
        return Applied(
            t_ns=t_ns,
            thrust_N=_triple(self._thrust),
            command_N=self._command,
            command_slew_N_per_s=slew,
            plan_epoch=0 if arrival is None else arrival.epoch,
            plan_sequence=-1 if arrival is None else arrival.sequence,
            plan_cycle_t_ns=0 if plan is None else plan.cycle_t_ns,
            plan_received_t_ns=0 if arrival is None else arrival.received_t_ns,
            plan_late=verdict is PlanVerdict.LATE,
            plans_late=self._gate.plans_late,
            plans_rejected=self._gate.plans_rejected,
            health=self._gate.health(t_ns),
        )


def _can_continue(from_ns: int, t_ns: int) -> bool:
    """The step to ``t_ns`` needs nothing said after that to ``from_ns``, nor another second's water."""
    return from_ns % REPORT_NS != 0 and t_ns % KNOT_NS != 0


def apply_mismatch(p: Coefficients, mismatch: Mismatch) -> Coefficients:
    """The true vehicle's coefficients: ``mass`` scales masses and inertia (not the net buoyancy), ``drag`` damping."""
    factors = {name: mismatch.drag for name in p._fields if name.startswith(("linear", "quadratic"))}
    factors |= dict.fromkeys(("mass_surge", "mass_sway", "mass_heave", "inertia_yaw", "dry_mass"), mismatch.mass)
    return p._replace(**{name: factor * getattr(p, name) for name, factor in factors.items()})


@jit
def simulate_steps(
    body: Array,
    s: Array,
    n: Array,
    F: Array,
    y: Array,
    commands: Array,
    t_ns: npt.NDArray[np.int64],
    seconds: Array,
    depths: Array,
    earlier: Array,
    later: Array,
    share: Array,
    seen_earlier: Array,
    seen_later: Array,
    seen_share: Array,
    factor: float,
    waves: Array,
    amplitude: float,
) -> Array:
    """``motion.step`` to each t (K,) under the commands (K, 3), and what is then seen, (K, 18): ``observe``.

    y[0] (3,) is the last command, y[1] the fastest change so far (N/s); both are kept up. The water of the steps, in
    their middle, and of what is seen, at their end: ``WaterColumn.throughout``.
    """
    seen = np.empty((len(t_ns), 18))
    for k in range(len(t_ns)):
        h = seconds[k]
        for i in range(3):
            y[1, i] = max(y[1, i], abs(commands[k, i] - y[0, i]) / h)
        motion.step(body, s, n, F, y[0], commands[k], t_ns[k] <= 0, h, depths, earlier, later, share[k])
        copy_to(y[0], commands[k])
        t_s = t_ns[k] * 1e-9
        observe(seen[k], s, F, factor, waves, amplitude, t_s, depths, seen_earlier, seen_later, seen_share[k])
    return seen


@jit
def observe(
    seen: Array,
    s: Array,
    F: Array,
    factor: float,
    waves: Array,
    amplitude: float,
    t: float,
    depths: Array,
    earlier: Array,
    later: Array,
    share: float,
) -> None:
    """The state, velocity over ground north and east, roll, pitch, heading, the current, delivered thrusts: (18,)."""
    copy_to(seen[:8], s)
    cn, ce = velocity_at(s[6], depths, earlier, later, share)
    # [n', e'] = R(psi) [u, v] + c(z)
    north, east = level_to_ned(s[2], s[3], s[4])
    seen[8], seen[9] = north + cn, east + ce
    seen[10], seen[11] = sum_of_sines(t, amplitude, waves)
    seen[12] = wrap_angle(s[4])
    seen[13], seen[14] = cn, ce
    for i in range(3):
        seen[15 + i] = factor * F[i]


@jit
def level_to_ned(u: float, v: float, heading: float) -> tuple[float, float]:
    """R(heading) [u, v]: north and east of a horizontal vector given ahead and to starboard."""
    cos, sin = math.cos(heading), math.sin(heading)
    return cos * u - sin * v, sin * u + cos * v


def _triple(a: Array) -> Triple:
    x, y, z = a.tolist()
    return x, y, z
