"""The latency profile: the same problems for every solver, in an order that changes, and errors beside times."""

from __future__ import annotations

import gc
import json
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import MotionLimits
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.solvers.interface import Result
from ltv_mpc.control.solvers.recorder import RecordingSolver
from ltv_mpc.messages import Estimate, Message, Plan, SolveStatus
from ltv_mpc.node import Inbox, Node
from services.cli.app import run
from services.recording.reader import Recording
from services.tools.profile import measure as measurement
from services.tools.profile import problems
from services.tools.profile import run as latency
from services.tools.profile.measure import STAGES, Candidate, Samples, measure, solver_by_name
from services.tools.python_run import simulate

OSQP, PIQP = solver_by_name("osqp"), solver_by_name("piqp")


def measured(episodes: list[problems.Episode], *candidates: Candidate) -> list[Samples]:
    """Without a warm-up to speak of."""
    warm_up = episodes[0]._replace(cycles=1)
    return measure(episodes, candidates, warm_up=warm_up, order=random.Random(1), progress=lambda: None)


class Probe(ControllerNode):
    """Stands in the controller's place and keeps what it hears, and what it would have planned."""

    def __init__(self, episode: problems.Episode) -> None:
        super().__init__(episode.vehicle, episode.reference, episode.config)
        self.estimates: list[Estimate] = []
        self.plans: list[Plan] = []

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        self.estimates += [arrival.message for arrival in inbox if isinstance(arrival.message, Estimate)]
        self.plans += [message for message in super().step(t_ns, inbox) if isinstance(message, Plan)]
        return []


def heard(episode: problems.Episode, estimates: int) -> list[Estimate]:
    probe = Probe(episode)
    episode.feed(probe, lambda: len(probe.estimates) >= estimates)
    return probe.estimates


@pytest.fixture(autouse=True, scope="module")
def little_is_flushed() -> Iterator[None]:
    """Flush hardly anything: it takes longer than the cycles."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measurement, "FLUSH_BYTES", 1 << 12)
        yield


# --- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def profiled(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    out = tmp_path_factory.mktemp("profile")
    (out / "run.mcap").touch()
    options = ["--horizons", "4, 8,4", "--solvers", "osqp", "--cycles", "10"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(latency, "WARM_UP", 2)
        assert run(["profile", *options, "--force", "--out", str(out)]) == 0
    return json.loads((out / "profile.json").read_text()), out


def test_each_solver_has_a_row_at_each_horizon_and_riccati_is_among_them(profiled: tuple[dict[str, Any], Path]) -> None:
    rows = profiled[0]["rows"]
    assert [(row["stages"], row["solver"]) for row in rows] == [
        (stages, solver) for stages in (4, 8) for solver in ("riccati", "osqp")
    ]
    assert [row["horizon_s"] for row in rows] == pytest.approx([1.2] * 2 + [2.4] * 2)
    for row in rows:
        assert row["cycles"] == sum(row["status"].values()) == 10
        assert set(row["status"]) <= {str(status) for status in SolveStatus}
        assert row["iterations"]["max"] > 0 or row["solver"] != "osqp"


def test_a_cycle_with_flushed_caches_takes_longer_than_a_repeated_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The shortest cycle of each: a busy machine only lengthens them."""
    monkeypatch.setattr(measurement, "FLUSH_BYTES", 1 << 26)
    found = measured(problems.simulated(6, 20, seed=3)[-1:], OSQP, PIQP)
    assert sum(min(of.flushed_us) for of in found) > sum(min(of.repeated_us) for of in found)


def test_stages_are_parts_of_the_cycle_and_ratios_to_riccati_at_the_same_horizon(profiled) -> None:
    rows = profiled[0]["rows"]
    for row in rows:
        assert list(row["stage_us"]) == list(STAGES)
        for spread in (row["cycle_us"], *row["stage_us"].values()):
            assert 0 < spread["median"] <= spread["p90"] <= spread["p99"] <= spread["max"]
        assert max(spread["max"] for spread in row["stage_us"].values()) < row["cycle_us"]["max"]
    for yardstick, other in (rows[:2], rows[2:]):
        assert yardstick["ratio"] == yardstick["flushed_ratio"] == {"median": 1.0, "p99": 1.0}
        for quantile in ("median", "p99"):
            for state in ("cycle", "repeated", "flushed"):
                ratio = other["ratio" if state == "cycle" else f"{state}_ratio"][quantile]
                assert ratio == pytest.approx(other[f"{state}_us"][quantile] / yardstick[f"{state}_us"][quantile])


# --- the measurement -------------------------------------------------------------------------------------------------


def test_every_candidate_has_the_same_problem_in_an_order_that_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also the one that cannot converge, whose own plans would lead it elsewhere."""
    asked: list[tuple[object, bytes]] = []
    solve = RecordingSolver.solve

    def noted(self: Any, problem: Problem, shift: float, *, last: bool = True) -> Result:
        asked.append((self, problem.f.tobytes() + problem.h.tobytes()))
        return solve(self, problem, shift, last=last)

    monkeypatch.setattr(RecordingSolver, "solve", noted)
    episode = problems.simulated(6, 20, seed=3)[0]
    assert episode.cycles == 10
    measured([episode._replace(config=msgspec.structs.replace(episode.config, tolerance=1e-1))], OSQP, PIQP)
    # each candidate interleaved and at once again, each with flushed caches; the first cycle's passes are its own
    cycles = [asked[-6 * k : len(asked) - 6 * (k - 1)] for k in range(10, 0, -1)]
    first, second = dict.fromkeys(who for who, _ in cycles[0])
    assert all(len({problem for _, problem in cycle}) == 1 for cycle in cycles)
    orders = {tuple(who for who, _ in cycle[:4]) for cycle in cycles}
    assert orders == {(first, first, second, second), (second, second, first, first)}
    assert all({who for who, _ in cycle[4:]} == {first, second} for cycle in cycles)


class Wrong:
    """Solver whose every number is 1 % off."""

    def __init__(self, solver: Any) -> None:
        self._solver = solver
        self.set_up = solver.set_up

    def solve(self, problem: Problem, shift: float, *, last: bool = True) -> Result:
        right = self._solver.solve(problem, shift, last=last)
        return right._replace(z=1.01 * right.z)


def test_a_fast_wrong_answer_shows() -> None:
    episode = problems.simulated(6, 20, seed=3)[-1]
    right, wrong = measured([episode], OSQP, Candidate("wrong", lambda *of: Wrong(OSQP.make_solver(*of))))
    assert np.median(right.thrust_error_N) < 1e-3
    assert np.median(wrong.thrust_error_N) > 100 * np.median(right.thrust_error_N)


def test_limits_of_the_motion_are_part_of_the_problem_for_all() -> None:
    episode = problems.simulated(6, 20, seed=3)[-1]
    limits = MotionLimits.symmetric(yaw_rate_radps=0.02)
    slow = episode._replace(config=msgspec.structs.replace(episode.config, limits=limits, tolerance=1e-7))
    found = measured([slow], OSQP, PIQP, solver_by_name("riccati"))
    assert max(np.median(of.thrust_error_N) for of in found) < 1e-3


def test_no_garbage_is_collected_within_a_cycle() -> None:
    episode = problems.simulated(2, 1, seed=0)[0]
    seen: list[bool] = []

    def feed(node: Node, enough: Callable[[], bool]) -> None:
        seen.append(gc.isenabled())
        episode.feed(node, enough)

    measured([episode._replace(feed=feed)], PIQP)
    assert seen == [False, False]
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


# --- the problems ----------------------------------------------------------------------------------------------------


def test_hard_episodes_begin_2_m_off_with_headings_up_to_3_rad_from_the_way_there() -> None:
    episodes = [episode for episode in problems.simulated(17, 1600, seed=0) if episode.kind == "hard"]
    headings = []
    for episode in episodes:
        first = heard(episode, 1)[0]
        north, east = episode.reference.position(episode.reference.anchor(first))
        assert np.hypot(north - first.north_m, east - first.east_m) == pytest.approx(2.0, abs=0.05)
        headings.append(first.heading_rad - np.arctan2(east - first.east_m, north - first.north_m))
    assert len(headings) == 10
    assert max(np.abs(headings)) < 3.05
    assert max(headings) > 1.5
    assert min(headings) < -1.5


def test_of_one_current_the_controller_is_told_nothing() -> None:
    told, untold, _ = problems.simulated(17, 40, seed=0)
    assert all(estimate.current is not None for estimate in heard(told, 3))
    estimates = heard(untold, 3)
    assert all(estimate.current is None for estimate in estimates)
    assert np.hypot(estimates[-1].velocity_north_mps, estimates[-1].velocity_east_mps) > 0  # but it drifts


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a run of 8 s with estimator."""
    out = tmp_path_factory.mktemp("runs") / "dive"
    simulate("descent", out=out, duration_s=8, horizon_s=2.4, sqp_iterations=1)  # as what is measured
    return out


def test_a_recorded_run_gives_the_controller_what_it_got(dive: Path) -> None:
    (episode,) = problems.recorded(str(dive), 8, cycles=10)
    probe = Probe(episode)
    episode.feed(probe, lambda: False)
    recorded = [message.typed()[0] for message in Recording(dive / "run.mcap") if message.kind is Plan]
    assert len(probe.plans) == len(recorded) > 25
    for made, was in zip(probe.plans, recorded, strict=True):
        assert isinstance(was, Plan)
        assert made.cycle_t_ns == was.cycle_t_ns
        np.testing.assert_array_equal(made.thrust_N, was.thrust_N)
    short = Probe(episode)
    episode.feed(short, lambda: len(short.plans) >= 5)
    assert 5 <= len(short.plans) < 15  # a long recording is not read to its end


def test_a_recorded_run_is_measured_at_any_horizon_and_json_has_stdout_to_itself(dive, capsys, monkeypatch) -> None:
    monkeypatch.setattr(latency, "WARM_UP", 2)
    options = ["--horizons", "2", "--solvers", "piqp, osqp,piqp", "--cycles", "10", "--json"]
    assert run(["profile", "--run", str(dive / "run.mcap"), *options]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [(row["stages"], row["cycles"]) for row in printed["rows"]] == [(2, 10)] * 3
    assert [row["solver"] for row in printed["rows"]] == ["riccati", "piqp", "osqp"]
    assert printed["problems"] == {"dive": 10}
