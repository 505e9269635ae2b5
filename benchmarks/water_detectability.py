"""Could any detector see what the filter is not told of? Fronts, waves, steps of the water, and a gyro's fault.

    .venv/bin/python -m benchmarks.water_detectability [--sensors NAME ...] [--seed N] [--json]

One descent is simulated without them; the filter hears it twice, as it was and with the change put into the very same
messages, without a gate (outliers are left out) and without adapting. With d nu the difference of the two runs'
innovations, S their covariance and d v that of the two estimates' velocities:
    lambda(t) = sum over messages up to t of  d nu^T S^-1 d nu
is the squared deflection of the likelihood ratio that knows shape, amplitude and instant of the change, the best
detector that there can be: at a false-alarm rate a its power is 1 - Phi(Phi^-1(1 - a) - sqrt(lambda)).
At lambda = 19 that is 90 % for a = 0.1 %. A detector that must find shape and instant itself needs more.
Source  Kay 1998, Fundamentals of statistical signal processing II, section 4.3; Willsky & Jones 1976, IEEE T-AC 21(1).
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter, Innovations
from ltv_mpc.localisation.filter.state import VELOCITY, Belief
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.messages import AdcpPing, Array, ImuSample, Truth
from ltv_mpc.node import Due, ReceivedMessage
from services.run.nodes import make_nodes
from services.tools import lockstep_run
from services.tools.batch.job import Job
from sim.scenario import Feature as Shape
from sim.scenario import Water
from sim.scheduler import LockStep, Observation, Step
from sim.sensors.adcp import Profiler, beams
from sim.sensors.node import Sensors
from sim.sensors.outlier_masks import Mask
from sim.water.features import Feature

BEGINS_S = 50.0
"""Start of every change: at 10 m of depth, with observed water and settled errors."""

_OPEN = msgspec.structs.replace(EstimatorConfig(), adapts_to_water=False, gate_probability=1.0)
"""Linear: everything is used, nothing adapted."""

_NOTHING = np.empty(0), np.empty((0, 0))


class Change(NamedTuple):
    """Change of the messages from ``BEGINS_S`` on: a water feature, or a gyro fault about the body's x axis."""

    name: str
    water: Shape | None = None
    gyro_radps: float = 0.0


def front(step_mps: float, width_s: float) -> Change:
    """Return a front that begins at ``BEGINS_S``."""
    shape = Shape(kind="front", step_mps=step_mps, width_s=width_s, at_s=BEGINS_S + 0.5 * width_s)
    return Change(f"front {100 * step_mps:g} cm/s in {width_s:g} s", shape)


def waves(amplitude_mps: float, period_s: float) -> Change:
    """Return internal waves, from the start on."""
    shape = Shape(kind="waves", amplitude_mps=amplitude_mps, period_s=period_s)
    return Change(f"waves {100 * amplitude_mps:g} cm/s, {period_s:g} s", shape)


def step(step_mps: float) -> Change:
    """Return a jump of the current over depth, at 25 m."""
    return Change(f"step {100 * step_mps:g} cm/s at 25 m", Shape(kind="step", step_mps=step_mps, at_m=25.0))


def gyro(deg_per_h: float) -> Change:
    """Return a gyro fault that begins at ``BEGINS_S``."""
    return Change(f"gyro {deg_per_h:g} deg/h", gyro_radps=math.radians(deg_per_h) / 3600.0)


CHANGES = (
    front(0.1, 10.0),
    front(0.1, 30.0),
    front(0.1, 60.0),
    front(0.05, 100.0),
    front(0.1, 100.0),
    front(0.2, 100.0),
    front(0.2, 140.0),
    waves(0.02, 600.0),
    waves(0.05, 600.0),
    waves(0.05, 300.0),
    waves(0.05, 200.0),
    step(0.1),
    step(0.3),
    gyro(10.0),
    gyro(30.0),
    gyro(100.0),
)


class _Ping(NamedTuple):
    """A ping's truth: where its beams look, (4, 3) NED, from which depth (m), and which cells are outliers."""

    beams: Array
    depth_m: float
    wild: Mask


class Descent:
    """One simulated descent: all messages in order of their validity, and the truth of each ping."""

    def __init__(self, sensors: str, seed: int, settings: Sequence[str] = ()) -> None:
        """Run the descent in lock step. Raises ``ConfigError``."""
        run_config = Job("descent", (f'sensors="{sensors}"', f"run.seed={seed}", *settings)).run_config()
        nodes = make_nodes(run_config)
        self.suite: SensorConfig = run_config.sensor_config
        self.water: Water = run_config.scenario.water
        self.steps: list[Due] = []  # of the estimator
        self.pings: dict[int, _Ping] = {}
        self._truth: Truth | None = None
        units = next(node for node in nodes if isinstance(node, Sensors)).sensors
        self._profiler = next(unit for unit in units if isinstance(unit, Profiler))
        self._beams = beams(self.suite.adcp.beam_angle_rad) @ self._profiler.mounting.T  # (4, 3), body
        scenario = run_config.scenario
        LockStep(
            nodes,
            start_ns=scenario.start_ns,
            observation=Observation(self, on_step=self._stepped),
            latest=lockstep_run.LATEST,
        ).advance(scenario.end_ns)
        self.end_ns = scenario.end_ns

    def _stepped(self, step: Step) -> None:
        """Keep the estimator's inboxes."""
        if step.node == Estimator.name:
            self.steps.append((step.t_ns, step.inbox))

    def published(self, node: str, message: ReceivedMessage) -> None:  # noqa: ARG002
        """Keep the true state at each ping."""
        match message.message:
            case Truth() as truth:
                self._truth = truth
            case AdcpPing(t_ns=t_ns) if self._truth is not None:
                R = rotation(*self._truth.attitude_rad)
                down = self._truth.position_m[2] + float(R[2] @ np.array(self.suite.adcp.lever_arm_m))
                wild = self._profiler.outlier_masks.at(t_ns)
                assert wild is not None
                self.pings[t_ns] = _Ping(self._beams @ R.T, down, wild)

    def aligned(self) -> tuple[Belief, list[ImuSample | Measurement]]:
        """Return the aligned filter's belief, and the measurements from there on in order of validity time."""
        estimator = Estimator(self.suite, _OPEN)
        rest = iter(self.steps)
        for t_ns, inbox in rest:
            estimator.steps([(t_ns, inbox)])
            if estimator.filter is not None:
                break
        else:
            raise RuntimeError("the descent has not been long enough to align")
        estimator.filter.propagate_covariance()
        belief = estimator.filter.belief
        later = [a.message for _, inbox in rest for a in inbox if isinstance(a.message, ImuSample | Measurement)]
        # a sample moves the filter to its time before anything else is used there
        later.sort(key=lambda m: (m.t_ns, not isinstance(m, ImuSample)))
        return belief.copy(), [m for m in later if m.t_ns > belief.t_ns]

    def clean(self, message: ImuSample | Measurement) -> ImuSample | Measurement:
        """Return the message without outliers."""
        if not isinstance(message, AdcpPing):
            return message
        z = np.where(self.pings[message.t_ns].wild, np.nan, message.beam_velocity_mps)
        return msgspec.structs.replace(message, beam_velocity_mps=z)

    def changed(self, message: ImuSample | Measurement, change: Change) -> ImuSample | Measurement:
        """Return the message as it would have been with the change."""
        replace, t_s = msgspec.structs.replace, message.t_ns * 1e-9
        if isinstance(message, ImuSample) and t_s > BEGINS_S:
            p, q, r = message.angular_rate_radps
            return replace(message, angular_rate_radps=(p + change.gyro_radps, q, r))
        if isinstance(message, AdcpPing) and change.water is not None:
            feature = Feature(replace(self.water, feature=change.water))
            ping = self.pings[message.t_ns]
            z = message.beam_velocity_mps.copy()
            for i, u in enumerate(ping.beams):
                z[i] += feature.velocity(ping.depth_m + u[2] * message.range_m, t_s) @ u[:2]
            return replace(message, beam_velocity_mps=z)
        return message


class _Heard(NamedTuple):
    """Result of one message in the filter of the unchanged messages."""

    said: ImuSample | Measurement
    residual: Array  # (m,); none of an inertial sample
    S: Array
    velocity: Array  # (2,)
    covariance: Array  # (2, 2), of the velocity


class Seen(NamedTuple):
    """Values at each ping, (T,)."""

    t_s: Array
    deflection: Array  # lambda
    off: Array  # sqrt(d v^T P_vv^-1 d v), horizontal
    off_mps: Array  # |d v|

    @property
    def gone(self) -> int | None:
        """Index of the first ping at which the velocity is off by 3 standard deviations or more."""
        beyond = np.flatnonzero(self.off > 3.0)
        return int(beyond[0]) if len(beyond) else None


class Comparison:
    """One descent, and what a filter that hears no change makes of it."""

    def __init__(self, descent: Descent) -> None:
        self._descent = descent
        self._from, messages = descent.aligned()
        self._unchanged = list(self._hear([descent.clean(message) for message in messages]))

    def with_(self, change: Change) -> Seen:
        """Run the filter on the same measurements, with the change added."""
        deflection, rows = 0.0, []
        heard = self._hear([self._descent.changed(one.said, change) for one in self._unchanged])
        for one, other in zip(self._unchanged, heard, strict=True):
            if len(one.residual):
                d = other.residual - one.residual
                deflection += float(d @ np.linalg.solve(one.S, d))
            if isinstance(one.said, AdcpPing):
                d = other.velocity - one.velocity
                off = math.sqrt(d @ np.linalg.solve(one.covariance, d))
                rows.append((one.said.t_ns * 1e-9, deflection, off, math.hypot(*d)))
        return Seen(*np.array(rows).T)

    def _hear(self, messages: Sequence[ImuSample | Measurement]) -> Iterator[_Heard]:
        filter_, verdicts = ErrorStateFilter(self._descent.suite, _OPEN, self._from.copy()), list[Innovations]()
        filter_.observers.append(verdicts.append)
        v, x, P = slice(VELOCITY.start, VELOCITY.start + 2), filter_.belief.x, filter_.belief.P
        for message in messages:
            if isinstance(message, ImuSample):
                filter_.advance(message.t_ns, message)
            else:
                filter_.correct(message)
            r, S = (verdicts[0].residual, verdicts[0].S) if verdicts else _NOTHING
            verdicts.clear()
            yield _Heard(message, r, S, x[v].copy(), P[v, v].copy())


def table(sensors: str, found: dict[str, Seen]) -> Iterator[str]:
    """One line a change."""
    yield f"{sensors:<26}{'3 sigma at':>12}{'lambda then':>13}{'at end':>9}{'largest error of velocity':>29}"
    for name, seen in found.items():
        k = seen.gone
        at, then = (f"{seen.t_s[k]:.0f} s", f"{seen.deflection[k]:.1f}") if k is not None else ("never", "")
        worst = int(np.argmax(seen.off))
        largest = f"{100 * seen.off_mps[worst]:.1f} cm/s, {seen.off[worst]:.1f} sigma"
        yield f"{name:<26}{at:>12}{then:>13}{seen.deflection[-1]:>9.1f}{largest:>29}"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", nargs="+", default=["paper", "realistic"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result: dict[str, dict[str, dict[str, float | None]]] = {}
    for sensors in options.sensors:
        comparison = Comparison(Descent(sensors, options.seed))
        found = {change.name: comparison.with_(change) for change in CHANGES}
        if not options.json:
            print("\n".join(table(sensors, found)), end="\n\n", flush=True)
        result[sensors] = {name: _row(seen) for name, seen in found.items()}
    if options.json:
        print(json.dumps(result, indent=2))


def _row(seen: Seen) -> dict[str, float | None]:
    k = seen.gone
    return {
        "gone_s": None if k is None else float(seen.t_s[k]),
        "lambda_then": None if k is None else float(seen.deflection[k]),
        "lambda_at_end": float(seen.deflection[-1]),
        "largest_sigma": float(seen.off.max()),
        "largest_mps": float(seen.off_mps.max()),
    }


if __name__ == "__main__":
    main()
