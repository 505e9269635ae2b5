"""Instrumented descent in lock step: the filter's state is compared with the truth at every whole second.

The true biases are copied right after the sensors' step of a whole second, the filter's state after the step that
publishes its estimate of that second. The run is not affected. The copies are compared when the truth of that second is
published, because nodes run ahead of their published messages (``sim/scheduler.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from benchmarks.batch import Job
from benchmarks.localisation_check.consistency import GridProjection, TrueState, nees, nodes_around, squared
from ltv_mpc.errors import ConfigError
from ltv_mpc.frames import rotation
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter, Innovations
from ltv_mpc.localisation.filter.state import VELOCITY, Belief, grid
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import AdcpPing, Array, Estimate, Message, Truth
from ltv_mpc.node import Inbox, Node
from services.run.nodes import make_nodes
from services.run.run_config import RunConfig
from services.tools import lockstep_run
from sim.evaluation.cramer_rao_bound import Trajectory, bound
from sim.sensors.adcp import Profiler
from sim.sensors.compass import MagneticCompass
from sim.sensors.imu import InertialUnit
from sim.sensors.node import Sensors

LOOK_NS = 1_000_000_000
"""Period of the comparison of belief and truth."""

TRACK_NS = 100_000_000
"""Period of the true track that the bound uses."""

EIGENVALUE_NS = 10_000_000_000
"""Period of the smallest eigenvalue of the covariance, which costs as much as ten other comparisons."""

OUTLIER_SD = 6.0
"""Deviations of an innovation beyond which it is an outlier: one of the profiler's has 25."""

N = TypeVar("N")


class Squares(NamedTuple):
    """Normalised squared errors of one quantity or sensor in one run, by instant."""

    t_ns: npt.NDArray[np.int64]
    square: Array
    dof: npt.NDArray[np.int64]


class Record(NamedTuple):
    """Result of one run."""

    drift_m: Array  # (2,) north, east: localisation error at the end minus that at t = 0
    velocity_error_mps: Array  # (2,) at t = 0, estimated minus true
    velocity_reported_m2ps2: Array  # (2,) variance reported by the filter at t = 0
    bound_drift_m2: Array  # (2,) variance
    bound_velocity_m2ps2: Array  # (2,) variance at t = 0
    true_error_m: float  # mean distance of the vehicle from the line through where it was at t = 0
    nees: dict[str, Squares]
    nis: dict[str, Squares]
    min_eigenvalue: float
    asymmetry: float  # largest |P - P^T|
    missed: int  # whole seconds without a belief of that time


def descend(job: Job) -> Record:
    """Run the job and compute the bound along its true track. Raises ``ConfigError``."""
    probe = Probe(job.run_config())
    probe.descend()
    return probe.record()


class _StepObserver:
    """Node wrapper that reports each step at a multiple of ``LOOK_NS``, and each for which ``also`` is true.

    ``observe`` receives the time and the output of the step.
    """

    def __init__(
        self, node: Node, observe: Callable[[int, Sequence[Message]], None], also: Callable[[], bool] = lambda: False
    ) -> None:
        self.name, self.reads, self.writes, self.schedule = node.name, node.reads, node.writes, node.schedule
        self._step, self._observe, self._also = node.step, observe, also

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        """Step the node and report the step."""
        output = self._step(t_ns, inbox)
        if t_ns % LOOK_NS == 0 or self._also():
            self._observe(t_ns, output)
        return output


class _Biases(NamedTuple):
    """True biases that change in time."""

    gyro_radps: Array  # (3,)
    accelerometer_mps2: Array  # (3,)
    compass_rad: float


class TrueStates:
    """True values of the filter's states at whole seconds, from the simulated sensors and water."""

    def __init__(self, run_config: RunConfig, sensors: Sensors) -> None:
        self.imu, self._adcp = _the(InertialUnit, sensors.sensors), _the(Profiler, sensors.sensors)
        self._compass = _the(MagneticCompass, sensors.sensors)
        self._water = run_config.water
        self._projection = GridProjection(grid(run_config.scenario.estimator), run_config.water.depth_m)
        self._biases: dict[int, _Biases] = {}

    def copy_biases(self, t_ns: int, output: Sequence[Message]) -> None:  # noqa: ARG002  (an observer of steps)
        """Copy the true biases after a step of the sensors."""
        if t_ns % LOOK_NS == 0:
            imu = self.imu
            self._biases[t_ns] = _Biases(imu.gyro_bias_radps, imu.accelerometer_bias_mps2, self._compass.bias_rad)

    def at(self, truth: Truth) -> TrueState:
        """Return the true state at a multiple of ``LOOK_NS``."""
        biases = self._biases[truth.t_ns]
        return TrueState(
            position_m=np.array(truth.position_m),
            velocity_mps=np.array(truth.velocity_mps),
            rotation=rotation(*truth.attitude_rad),
            gyro_bias_radps=biases.gyro_radps,
            accelerometer_bias_mps2=biases.accelerometer_mps2,
            beam_bias_mps=self._adcp.beam_bias_mps,
            near_bias_mps=self._adcp.near_bias_mps,
            mounting=self._adcp.mounting,
            compass_bias_rad=biases.compass_rad,
            water_mps=self._projection.fit(self._current_mps(truth.t_ns)),
        )

    def _current_mps(self, t_ns: int) -> Array:
        return self._water.over(self._projection.depth_m, t_ns)


class ObservedGridPoints:
    """Grid points of the current that a beam has measured so far."""

    def __init__(self, run_config: RunConfig, sensors: Sensors) -> None:
        config, adcp = run_config.scenario.estimator, run_config.sensor_config.adcp
        self.mask = np.zeros(len(grid(config)), dtype=bool)
        self._cell_m = config.cell_m
        self._beams = beam_directions(adcp.beam_angle_rad) @ _the(Profiler, sensors.sensors).mounting.T
        self._lever = np.array(adcp.lever_arm_m)

    def add(self, ping: AdcpPing, truth: Truth) -> None:
        """Mark the grid points around the cells that returned."""
        down = rotation(*truth.attitude_rad)[2]
        along = down @ self._lever + np.outer(self._beams @ down, ping.range_m)  # (4, K)
        returned = np.isfinite(ping.beam_velocity_mps)
        self.mask |= nodes_around(truth.position_m[2] + along[returned], self._cell_m, len(self.mask))


class SquaresLog:
    """Normalised squares by the name of a quantity or sensor, over time."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[int, float, int]]] = {}

    def add(self, name: str, t_ns: int, square: float, dof: int) -> None:
        """Add one square with its degrees of freedom."""
        self._rows.setdefault(name, []).append((t_ns, square, dof))

    def all(self) -> dict[str, Squares]:
        """Return the squares so far by name."""
        return {name: _squares(rows) for name, rows in self._rows.items()}


class InnovationLog:
    """NIS of each sensor before the gate, without outliers: rows beyond ``OUTLIER_SD``."""

    def __init__(self) -> None:
        self.nis = SquaresLog()

    def add(self, innovations: Innovations) -> None:
        """Add the innovations of one message."""
        r, S = innovations.residual, innovations.S
        good = r * r <= OUTLIER_SD**2 * np.diagonal(S)
        if good.any():
            square = squared(r[good], S[np.ix_(good, good)])
            self.nis.add(innovations.sensor, innovations.t_ns, square, int(good.sum()))


class ErrorLog:
    """Errors of the estimates, and checks of the covariance at whole seconds."""

    def __init__(self) -> None:
        self.error: dict[int, Array] = {}  # position and velocity, (4,), estimated minus true, by time
        self.nees = SquaresLog()
        self.velocity_m2ps2 = np.full(2, np.nan)  # reported variance at t = 0
        self.min_eigenvalue, self.asymmetry, self.missed = np.inf, 0.0, 0

    def add_estimate(self, estimate: Estimate, truth: Truth) -> None:
        """Add the error of a published estimate."""
        estimated = estimate.north_m, estimate.east_m, estimate.velocity_north_mps, estimate.velocity_east_mps
        self.error[estimate.t_ns] = np.array(estimated) - np.array(truth.position_m[:2] + truth.velocity_mps[:2])

    def add_belief(self, belief: Belief, true: TrueState, observed: npt.NDArray[np.bool_]) -> None:
        """Compare a belief with the true state; ``observed`` is the mask of observed grid points."""
        t_ns, P = belief.t_ns, belief.P
        for name, (square, dof) in nees(belief, true, observed).items():
            self.nees.add(name, t_ns, square, dof)
        if t_ns == 0:
            self.velocity_m2ps2 = np.diagonal(P)[VELOCITY][:2].copy()
        self.asymmetry = max(self.asymmetry, float(np.abs(P - P.T).max()))
        if t_ns % EIGENVALUE_NS == 0:
            self.min_eigenvalue = min(self.min_eigenvalue, float(np.linalg.eigvalsh(P)[0]))


class Probe:
    """Observer of a run: it compares the estimator with the truth. The run is not affected."""

    def __init__(self, run_config: RunConfig) -> None:
        """Set up the nodes of a run. Raises ``ConfigError``."""
        self._run_config = run_config
        nodes = make_nodes(run_config, publish_unread_topics=False)
        self.estimator, sensors = _the(Estimator, nodes), _the(Sensors, nodes)
        self.truth: Truth | None = None  # the last
        self.true_states = TrueStates(run_config, sensors)
        self.observed = ObservedGridPoints(run_config, sensors)
        self._innovations = InnovationLog()
        self._errors = ErrorLog()
        self._track: list[Truth] = []
        self._filter: ErrorStateFilter | None = None  # observed now
        self._beliefs: dict[int, Belief] = {}  # not compared with the truth yet
        observed = {
            sensors.name: _StepObserver(sensors, self.true_states.copy_biases),
            self.estimator.name: _StepObserver(
                self.estimator, self._copy_belief, also=lambda: self.estimator.filter is None
            ),
        }
        self._nodes: list[Node] = [observed.get(node.name, node) for node in nodes]

    def descend(self) -> None:
        """Run the whole descent."""
        lockstep_run.simulate(self._run_config, nodes=self._nodes, keep=self._observe)

    def _copy_belief(self, t_ns: int, output: Sequence[Message]) -> None:
        """Observe the current filter, and copy its belief at whole seconds.

        The first filter is observed from its next message on, a later one from the next cycle on.
        """
        filter_ = self.estimator.filter
        if filter_ is not self._filter:
            self._filter = filter_
            if filter_ is not None:
                filter_.observers.append(self._innovations.add)
        published = t_ns % LOOK_NS == 0 and any(isinstance(message, Estimate) for message in output)
        if published and filter_ is not None and filter_.belief.t_ns == t_ns >= 0:
            self._beliefs[t_ns] = filter_.propagated_belief()

    def _observe(self, message: Message) -> None:
        match message:
            case Truth() as truth:
                self.truth = truth
                if truth.t_ns % TRACK_NS == 0:
                    self._track.append(truth)
            case AdcpPing() as ping if self.truth is not None:
                self.observed.add(ping, self.truth)
            case Estimate() as estimate if self.truth is not None and estimate.t_ns >= 0:
                self._compare(estimate, self.truth)

    def _compare(self, estimate: Estimate, truth: Truth) -> None:
        """Compare an estimate, and at whole seconds the belief, with the truth of the same time."""
        t_ns = estimate.t_ns
        if t_ns == truth.t_ns:
            self._errors.add_estimate(estimate, truth)
        if t_ns % LOOK_NS != 0:
            return
        belief = self._beliefs.pop(t_ns, None)
        if belief is None or t_ns != truth.t_ns:
            self._errors.missed += 1
        else:
            self._errors.add_belief(belief, self.true_states.at(truth), self.observed.mask)

    @property
    def nees(self) -> dict[str, Squares]:
        """NEES of each quantity so far."""
        return self._errors.nees.all()

    def record(self) -> Record:
        """Return the result after the run. Raises ``ConfigError`` if there was no estimate at t = 0."""
        run_config, errors = self._run_config, self._errors
        if 0 not in errors.error:
            problem = "must be long enough for an estimate at t = 0"
            value = run_config.scenario.run.surface_time_s
            raise ConfigError(f"scenario {run_config.name}", "[run] surface_time_s", problem, value=value)
        end_ns = max(errors.error)
        limit = bound(
            run_config.sensor_config,
            run_config.scenario.estimator,
            self._trajectory(),
            at_s=[0.0, end_ns * 1e-9],
            surface_time_s=run_config.scenario.run.surface_time_s,
        )
        return Record(
            drift_m=(errors.error[end_ns] - errors.error[0])[:2],
            velocity_error_mps=errors.error[0][2:],
            velocity_reported_m2ps2=errors.velocity_m2ps2,
            bound_drift_m2=np.diagonal(limit.drift[1])[:2].copy(),
            bound_velocity_m2ps2=np.diagonal(limit.covariance[0])[3:5].copy(),
            true_error_m=self._true_error_m(),
            nees=self.nees,
            nis=self._innovations.nis.all(),
            min_eigenvalue=float(errors.min_eigenvalue),
            asymmetry=errors.asymmetry,
            missed=errors.missed,
        )

    def _true_error_m(self) -> float:
        """Return the mean distance of the vehicle from the line through its position at t = 0."""
        track = np.array([truth.position_m[:2] for truth in self._track if truth.t_ns >= 0])
        return float(np.hypot(*(track - track[0]).T).mean())

    def _trajectory(self) -> Trajectory:
        return Trajectory(
            t_s=np.array([truth.t_ns * 1e-9 for truth in self._track]),
            position_m=np.array([truth.position_m for truth in self._track]),
            velocity_mps=np.array([truth.velocity_mps for truth in self._track]),
            rotation=np.array([rotation(*truth.attitude_rad) for truth in self._track]),
            water_mps=self._run_config.water.over(grid(self._run_config.scenario.estimator), 0),
        )


def _squares(rows: list[tuple[int, float, int]]) -> Squares:
    t, square, dof = zip(*rows, strict=True)
    return Squares(np.array(t, dtype=np.int64), np.array(square), np.array(dof, dtype=np.int64))


def _the(kind: type[N], among: Sequence[object]) -> N:
    return next(one for one in among if isinstance(one, kind))
