"""Plan of a dive beside simulated dives: their drift lies in the interval of as many dives with the planned drift."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.localisation_check.consistency import band
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.messages import Array, Estimate, Message, Truth
from ltv_mpc.node import Grid, Inbox, ReceivedMessage
from services.run.nodes import make_nodes
from services.run.run_config import RunConfig
from services.tools import lockstep_run
from services.tools.dive_plan import plan
from services.tools.dive_plan.plan import Dive
from sim import water
from sim.scheduler import LockStep, Observation
from sim.sensors.node import Sensors

DURATION_S, DEPTH_M, DIVES = 8.0, 1.6, 16
SENSORS = ("paper", "examples/sensors/600_khz.toml")


class Track:
    """Node that repeats the truths of a dive."""

    name = "plant"
    schedule = Grid(10_000_000)
    reads: tuple[type[Message], ...] = ()
    writes: tuple[type[Message], ...] = (Truth,)

    def __init__(self) -> None:
        self.truths: dict[int, Truth] = {}

    def published(self, node: str, message: ReceivedMessage) -> None:  # noqa: ARG002 (the type implies the node)
        assert isinstance(message.message, Truth)
        self.truths[message.message.t_ns] = message.message

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        return [self.truths[t_ns]]


class Errors:
    """Error of the estimated position, north and east (m), by time."""

    def __init__(self, track: Track) -> None:
        self._truths = track.truths
        self.at: dict[int, Array] = {}

    def published(self, node: str, message: ReceivedMessage) -> None:  # noqa: ARG002
        estimate = message.message
        assert isinstance(estimate, Estimate)
        self.at[estimate.t_ns] = np.array([estimate.north_m, estimate.east_m])
        self.at[estimate.t_ns] -= self._truths[estimate.t_ns].position_m[:2]


def drift_m(run_config: RunConfig, track: Track, seed: int) -> Array:
    """Return the drift (2,) of one dive along the track, whose noise, biases and water are those of the seed."""
    scenario = replace(run_config.scenario, run=replace(run_config.scenario.run, seed=seed))
    estimator = Estimator(run_config.sensor_config, scenario.estimator)
    column = water.make(scenario.water, seed)
    sensors = Sensors(scenario, run_config.sensor_config, column, needed=frozenset(estimator.reads))
    errors = Errors(track)
    lockstep = LockStep(
        [track, sensors, estimator],
        start_ns=scenario.start_ns,
        observation=Observation(errors, types=frozenset({Estimate})),
        latest=lockstep_run.LATEST,
    )
    lockstep.advance(scenario.end_ns)
    return errors.at[scenario.end_ns] - errors.at[0]


@pytest.mark.parametrize("sensors", SENSORS)
def test_the_drift_of_simulated_dives_is_that_of_the_plan(sensors: str) -> None:
    dive = Dive(sensors, None, DURATION_S, DEPTH_M, 1, seed=1)
    run_config, track = dive.run_config(), Track()
    LockStep(
        make_nodes(run_config, publish_unread_topics=False),
        start_ns=run_config.scenario.start_ns,
        observation=Observation(track, types=frozenset({Truth})),
        latest=lockstep_run.LATEST,
    ).advance(run_config.scenario.end_ns)
    planned_m = plan.fly(dive).drift_m[-1]
    drifts = np.array([drift_m(run_config, track, seed) for seed in range(DIVES)])
    low, high = np.sqrt(np.array(band(drifts.size)) / drifts.size)
    ratio = float(np.sqrt(np.mean(drifts**2))) / planned_m
    assert low < ratio < high
