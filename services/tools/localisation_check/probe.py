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

from ltv_mpc.errors import ConfigError
from ltv_mpc.frames import rotation
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter, Innovations
from ltv_mpc.localisation.filter.state import VELOCITY, Belief, grid
from ltv_mpc.messages import AdcpPing, Array, Estimate, Message, Truth
from ltv_mpc.node import Due, Node, ReceivedMessage
from services.run.nodes import make_nodes
from services.run.run_config import RunConfig
from services.tools import lockstep_run
from services.tools.batch.job import Job
from sim.evaluation.cells import GridProjection
from sim.evaluation.consistency import TrueState, drawn, nees, nodes_around, squared
from sim.evaluation.cramer_rao_bound import Trajectory, bound
from sim.scheduler import LockStep
from sim.sensors.adcp import Profiler, beams
from sim.sensors.compass import MagneticCompass
from sim.sensors.imu import InertialUnit
from sim.sensors.node import Sensors
from sim.sensors.outlier_masks import HasOutliers

LOOK_NS = 1_000_000_000
TRACK_NS = 100_000_000
"""Between two looks at the belief; between two points of the true track, for the bound."""

EIGENVALUE_NS = 10_000_000_000
"""Between two looks at the least eigenvalue, which takes as long as ten of the other looks."""

N = TypeVar("N")


class Squares(NamedTuple):
    """Normalised squared errors of one quantity or sensor in one run, by instant."""

    t_ns: npt.NDArray[np.int64]
    square: Array
    dof: npt.NDArray[np.int64]


class Record(NamedTuple):
    """Result of one run."""

    drift_m: Array  # (2,) north, east: localisation error at the end less that at t = 0
    velocity_error_mps: Array  # (2,) at t = 0, estimated minus true
    velocity_reported_m2ps2: Array  # (2,) variance that the filter says
    bound_drift_m2: Array  # (2,) variance
    bound_velocity_m2ps2: Array  # (2,) variance at t = 0
    true_error_m: float  # mean distance of the vehicle from the line through where it was at t = 0
    drawn: dict[str, tuple[float, int]]  # normalised square of the true biases themselves, and its degrees of freedom
    nees: dict[str, Squares]
    nis: dict[str, Squares]
    min_eigenvalue: float
    asymmetry: float  # largest |P - P^T|
    missed: int  # instants at which the filter stood elsewhere


def descend(job: Job) -> Record:
    """Run the job and compute the bound along its true track. Raises ``ConfigError``."""
    probe = Probe(job.run_config())
    probe.descend()
    return probe.record()


class _Biases(NamedTuple):
    """True biases that change in time."""

    gyro_radps: Array  # (3,)
    accelerometer_mps2: Array  # (3,)
    compass_rad: float


class _Watched:
    """Node wrapper that reports each step to an observer."""

    def __init__(
        self,
        node: Node,
        ran: Callable[[int, Sequence[Message]], None],
        closely: Callable[[], bool] = lambda: False,
    ) -> None:
        """Wrap a node; ``ran`` receives time and output of each step at a multiple of ``LOOK_NS``, or of all while
        ``closely``.
        """
        self.name, self.reads, self.writes, self.schedule = node.name, node.reads, node.writes, node.schedule
        self._steps, self._ran, self._closely = node.steps, ran, closely

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Step the node, in batches that end at the steps to observe."""
        said: list[list[Message]] = []
        for number, (t_ns, _) in enumerate(due, 1):
            if t_ns % LOOK_NS == 0 or number == len(due) or self._closely():
                said += self._steps(due[len(said) : number])
                self._ran(t_ns, said[-1])
        return said


class Probe:
    """Observer of a run: it compares the estimator with the truth."""

    message_types: frozenset[type[Message]] = frozenset({Truth, AdcpPing, Estimate})

    def __init__(self, run_config: RunConfig) -> None:
        """Set up the nodes of a run. Raises ``ConfigError``."""
        self._run_config = run_config
        nodes = make_nodes(run_config, unread=False)
        self.estimator, sensors = _the(Estimator, nodes), _the(Sensors, nodes)
        watched = {
            sensors.name: _Watched(sensors, self._measured),
            self.estimator.name: _Watched(self.estimator, self._estimated, lambda: self.estimator.filter is None),
        }
        self._nodes: list[Node] = [watched.get(node.name, node) for node in nodes]
        units = sensors.sensors
        self.imu, self._profiler = _the(InertialUnit, units), _the(Profiler, units)
        self._compass = _the(MagneticCompass, units)
        self._outlier_masks = {
            name: unit.outlier_masks for name, unit in sensors.by_name.items() if isinstance(unit, HasOutliers)
        }
        config = run_config.scenario.estimator
        self._grid, self._cell_m = grid(config), config.cell_m
        self._cells = GridProjection(self._grid, run_config.water.depth_m)
        self.seen = np.zeros(len(self._grid), dtype=bool)  # nodes of the grid that a beam has measured so far
        self._beams = beams(run_config.suite.adcp.beam_angle_rad) @ self._profiler.mounting.T
        self._lever = np.array(run_config.suite.adcp.lever_arm_m)
        self._watched: ErrorStateFilter | None = None
        self._beliefs: dict[int, Belief] = {}  # not compared with the truth yet
        self._biases: dict[int, _Biases] = {}
        self.truth: Truth | None = None  # the last
        self._track: list[Truth] = []
        self._nees: dict[str, list[tuple[int, float, int]]] = {}
        self._nis: dict[str, list[tuple[int, float, int]]] = {}
        self._error: dict[int, Array] = {}  # of position and velocity, (4,), estimated minus true
        self._velocity_said = np.full(2, np.nan)
        self._drawn: dict[str, tuple[float, int]] = {}
        self._least, self._asymmetry, self._missed = np.inf, 0.0, 0

    def descend(self) -> None:
        """Run the whole descent."""
        scenario = self._run_config.scenario
        LockStep(
            self._nodes,
            start_ns=scenario.start_ns,
            compute_delay_ns=round(scenario.run.compute_delay_s * 1e9),
            observe=self,
            heard=self.message_types,
            latest=lockstep_run.LATEST,
        ).advance(scenario.end_ns)

    def _measured(self, t_ns: int, said: Sequence[Message]) -> None:  # noqa: ARG002  (whatever it was)
        if t_ns % LOOK_NS == 0:
            imu = self.imu
            self._biases[t_ns] = _Biases(imu.gyro_bias_radps, imu.accelerometer_bias_mps2, self._compass.bias_rad)

    def _estimated(self, t_ns: int, said: Sequence[Message]) -> None:
        """Attach the observer to the current filter and keep its state at whole seconds. The first filter is observed
        from its next message on, a later one from the next cycle on.
        """
        filter_ = self.estimator.filter
        if filter_ is not self._watched:
            self._watched = filter_
            if filter_ is not None:
                filter_.observers.append(self._judge)
        published = t_ns % LOOK_NS == 0 and any(isinstance(signal, Estimate) for signal in said)
        if published and filter_ is not None and filter_.belief.t_ns == t_ns >= 0:
            self._beliefs[t_ns] = filter_.propagated_belief()

    def published(self, node: str, message: ReceivedMessage) -> None:  # noqa: ARG002  (the type says who)
        """Take a published message."""
        match message.message:
            case Truth() as truth:
                self.truth = truth
                if truth.t_ns % TRACK_NS == 0:
                    self._track.append(truth)
            case AdcpPing() as ping:
                self._see(ping)
            case Estimate() as estimate if self.truth is not None:
                self._compare(estimate, self.truth)

    def record(self) -> Record:
        """Return the result after the run. Raises ``ConfigError`` if there was no estimate at t = 0."""
        run_config = self._run_config
        if 0 not in self._error:
            problem = "must be so long that the estimate has begun at t = 0"
            value = run_config.scenario.run.surface_time_s
            raise ConfigError(f"scenario {run_config.name}", "[run] surface_time_s", problem, value=value)
        end_ns = max(self._error)
        limit = bound(
            run_config.suite,
            run_config.scenario.estimator,
            self._trajectory(),
            at_s=[0.0, end_ns * 1e-9],
            surface_time_s=run_config.scenario.run.surface_time_s,
        )
        return Record(
            drift_m=(self._error[end_ns] - self._error[0])[:2],
            velocity_error_mps=self._error[0][2:],
            velocity_reported_m2ps2=self._velocity_said,
            bound_drift_m2=np.diagonal(limit.drift[1])[:2].copy(),
            bound_velocity_m2ps2=np.diagonal(limit.covariance[0])[3:5].copy(),
            true_error_m=self._true_error(),
            drawn=self._drawn,
            nees=self.nees,
            nis={name: _squares(rows) for name, rows in self._nis.items()},
            min_eigenvalue=float(self._least),
            asymmetry=self._asymmetry,
            missed=self._missed,
        )

    @property
    def nees(self) -> dict[str, Squares]:
        """Return the NEES of each quantity so far."""
        return {name: _squares(rows) for name, rows in self._nees.items()}

    def subgrid_mps(self, t_ns: int) -> float:
        """Return the part of the current (m/s) that the filter's depth grid cannot represent."""
        return self._cells.subgrid_mps(self._run_config.water.over(self._cells.depth_m, t_ns))

    def _true_error(self) -> float:
        track = np.array([truth.position_m[:2] for truth in self._track if truth.t_ns >= 0])
        return float(np.hypot(*(track - track[0]).T).mean())

    def _see(self, ping: AdcpPing) -> None:
        """Mark the grid points around the beams that returned."""
        if self.truth is None:
            return
        down = rotation(*self.truth.attitude_rad)[2]
        along = down @ self._lever + np.outer(self._beams @ down, ping.range_m)  # (4, K)
        back = np.isfinite(ping.beam_velocity_mps)
        self.seen |= nodes_around(self.truth.position_m[2] + along[back], self._cell_m, len(self.seen))

    def _judge(self, verdict: Innovations) -> None:
        """Record the NIS of one message before the gate; simulated outliers are left out."""
        good = np.ones(len(verdict.residual), dtype=bool)
        outlier_masks = self._outlier_masks.get(verdict.sensor)
        if outlier_masks is not None and (wild := outlier_masks.at(verdict.t_ns)) is not None:
            good = ~(wild.ravel()[verdict.indices] if wild.size > 1 else wild)
        if good.any():
            row = verdict.t_ns, squared(verdict.residual[good], verdict.S[np.ix_(good, good)]), int(good.sum())
            self._nis.setdefault(verdict.sensor, []).append(row)

    def _compare(self, estimate: Estimate, truth: Truth) -> None:
        t_ns = estimate.t_ns
        if t_ns < 0:
            return
        if t_ns == truth.t_ns:
            said = estimate.north_m, estimate.east_m, estimate.velocity_north_mps, estimate.velocity_east_mps
            self._error[t_ns] = np.array(said) - np.array(truth.position_m[:2] + truth.velocity_mps[:2])
        if t_ns % LOOK_NS != 0:
            return
        belief = self._beliefs.pop(t_ns, None)
        if belief is None or t_ns != truth.t_ns:
            self._missed += 1
            return
        true = self.true_state(truth)
        for name, (square, dof) in nees(belief, true, self.seen).items():
            self._nees.setdefault(name, []).append((t_ns, square, dof))
        P = belief.P
        if t_ns == 0:
            self._velocity_said = np.diagonal(P)[VELOCITY][:2].copy()
            self._drawn = drawn(true, self._run_config.suite)
        self._asymmetry = max(self._asymmetry, float(np.abs(P - P.T).max()))
        if t_ns % EIGENVALUE_NS == 0:
            self._least = min(self._least, float(np.linalg.eigvalsh(P)[0]))

    def true_state(self, truth: Truth) -> TrueState:
        """Return the true state at a multiple of ``LOOK_NS``."""
        biases = self._biases[truth.t_ns]
        return TrueState(
            position_m=np.array(truth.position_m),
            velocity_mps=np.array(truth.velocity_mps),
            rotation=rotation(*truth.attitude_rad),
            gyro_bias_radps=biases.gyro_radps,
            accelerometer_bias_mps2=biases.accelerometer_mps2,
            beam_bias_mps=self._profiler.beam_bias_mps,
            near_bias_mps=self._profiler.near_bias_mps,
            mounting=self._profiler.mounting,
            compass_bias_rad=biases.compass_rad,
            water_mps=self._cells.fit(self._run_config.water.over(self._cells.depth_m, truth.t_ns)),
        )

    def _trajectory(self) -> Trajectory:
        return Trajectory(
            t_s=np.array([truth.t_ns * 1e-9 for truth in self._track]),
            position_m=np.array([truth.position_m for truth in self._track]),
            velocity_mps=np.array([truth.velocity_mps for truth in self._track]),
            rotation=np.array([rotation(*truth.attitude_rad) for truth in self._track]),
            water_mps=self._run_config.water.over(self._grid, 0),
        )


def _squares(rows: list[tuple[int, float, int]]) -> Squares:
    t, square, dof = zip(*rows, strict=True)
    return Squares(np.array(t, dtype=np.int64), np.array(square), np.array(dof, dtype=np.int64))


def _the(kind: type[N], among: Sequence[object]) -> N:
    return next(one for one in among if isinstance(one, kind))
