"""The first fix after a long time without: the estimate jumps, the thrusts do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ltv_mpc.messages import Applied, Estimate, Truth, UsblFix
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from services.tools import lockstep_run
from sim.scheduler import LockStep, Observation

SECOND = 1_000_000_000
FIRST_FIX_S, END_S = 20, 45
USBL = Path(__file__).resolve().parents[2] / "examples" / "sensors" / "usbl.toml"


class WithoutFixes:
    """Sensors node without USBL fixes before ``FIRST_FIX_S``."""

    def __init__(self, node):
        self.node = node
        self.name, self.schedule, self.reads, self.writes = node.name, node.schedule, node.reads, node.writes

    def step(self, t_ns, inbox):
        said = self.node.step(t_ns, inbox)
        return [s for s in said if not (isinstance(s, UsblFix) and s.t_ns < FIRST_FIX_S * SECOND)]


class Ears:
    def __init__(self):
        self.heard = {Truth: [], Estimate: [], Applied: []}

    def published(self, _node, message):
        if type(message.message) in self.heard:
            self.heard[type(message.message)].append(message.message)


@pytest.fixture(scope="module")
def run():
    settings = [f"sensors={USBL}", f"run.duration_s={END_S}", "run.seed=3", "plant.depth_m=5"]
    run_config = resolve("descent", [Override("test", settings)])
    nodes = [WithoutFixes(n) if n.name == "sensors" else n for n in make_nodes(run_config)]
    ears = Ears()
    LockStep(
        nodes, start_ns=run_config.scenario.start_ns, latest=lockstep_run.LATEST, observation=Observation(ears)
    ).advance(END_S * SECOND)
    return run_config, ears.heard


def track(signals, place):
    return np.array([s.t_ns for s in signals]) / SECOND, np.array([place(s) for s in signals])


def test_the_estimate_jumps_by_metres_and_is_right_afterwards(run):
    """The satellite fix at the surface has an error of 5 m (1 sigma); a fix from the ship of about 1 m."""
    _, heard = run
    t, p = track(heard[Estimate], lambda e: (e.north_m, e.east_m))
    steps = np.hypot(*np.diff(p, axis=0).T)
    under_way = t[1:] > 1.0
    jump = np.argmax(np.where(under_way, steps, 0.0))
    assert steps[jump] > 1.5
    assert FIRST_FIX_S <= t[1:][jump] < FIRST_FIX_S + 5
    assert steps[under_way & (t[1:] < FIRST_FIX_S)].max() < 0.1
    _, truth = track(heard[Truth], lambda s: s.position_m[:2])
    before = p[t <= FIRST_FIX_S][-1] - truth[np.searchsorted([s.t_ns for s in heard[Truth]], FIRST_FIX_S * SECOND)]
    after = p[-1] - truth[-1]
    assert np.hypot(*before) > 2.0
    assert np.hypot(*after) < 1.5


def test_the_thrusts_go_on_within_their_slew_limit(run):
    run_config, heard = run
    limit = run_config.vehicle.thrusters[0].slew_N_per_s
    t, F = track(heard[Applied], lambda a: a.command_N[:2])
    under_way = t > 0
    rate = np.abs(np.diff(F[under_way], axis=0)) / np.diff(t[under_way])[:, None]
    assert rate.max() <= limit * (1 + 1e-9)
    assert max(max(a.command_slew_N_per_s[:2]) for a in heard[Applied] if a.t_ns > 0) <= limit * (1 + 1e-9)
    assert max(a.plans_rejected for a in heard[Applied]) == 0
