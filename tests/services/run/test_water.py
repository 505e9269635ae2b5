"""Water estimate of one run as the prior of the next: saved with its uncertainty, loaded, and useful."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pytest

from ltv_mpc.currents import WaterPrior, read_prior, write_profile
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.filter.state import Belief
from ltv_mpc.messages import CurrentProfile, Estimate, Message, Truth
from services.cli.app import run
from services.processes import estimator as process
from services.recording.reader import Recording
from services.run import folder
from services.run.nodes import make_nodes
from services.run.run_config import Override, RunConfig, resolve
from services.run.summary import summarise_recording
from services.run.water import EstimatedCurrent, load_prior
from services.tools import lockstep_run

DURATION = "run.duration_s=30"
BELOW_FIRST_PING = slice(30, 34)
"""Depths that 30 s show well and the first pings do not: 30 m along a beam reach to 28 m, from 6 m of depth to 34."""


def run_config(*settings: str) -> RunConfig:
    return resolve("descent", [Override("test", settings)])


class Visit(NamedTuple):
    """Result of a run."""

    saved: WaterPrior
    estimate: Estimate
    truth: Truth
    belief: Belief


def visit(here: RunConfig) -> Visit:
    """Run it without a recording, which would take most of the time."""
    nodes, learned, newest = make_nodes(here), EstimatedCurrent(), dict[type[Message], Any]()

    def keep(message: Message) -> None:
        newest[type(message)] = message
        if isinstance(message, Estimate):
            learned.update(message)

    lockstep_run.simulate(here, nodes=nodes, keep=keep)
    saved = learned.prior()
    (estimator,) = (node for node in nodes if isinstance(node, Estimator))
    assert saved is not None
    assert estimator.filter is not None
    estimator.filter.propagate_covariance()
    return Visit(saved, newest[Estimate], newest[Truth], estimator.filter.belief)


@pytest.fixture(scope="module")
def first() -> Visit:
    """Visit of a place whose water a later run knows."""
    return visit(run_config(DURATION, "run.seed=0"))


# --- what is saved ------------------------------------------------------------------------------------------------


def estimate(first_m: float, sd_mps: float, *, known: bool = True) -> Estimate:
    """Return an estimate: a window of three depths, currents equal to the depths, and a velocity sd of 2 and 3 cm/s."""
    depth = first_m + np.arange(3.0)
    sd = np.full(3, sd_mps)
    current = CurrentProfile(depth_m=depth, north_mps=depth / 100, east_mps=-depth / 100, sd_mps=sd if known else None)
    covariance = np.diag([25.0, 25.0, 0.02**2, 0.03**2, 1e-4, 1e-4])
    return msgspec.structs.replace(Estimate.at_rest(), current=current, covariance=covariance)


def heard(*estimates: Estimate) -> WaterPrior | None:
    learned = EstimatedCurrent()
    for each in estimates:
        learned.update(each)
    return learned.prior()


def test_depths_behind_the_window_keep_their_last_estimate_others_the_newest() -> None:
    water = heard(estimate(0, 0.1), estimate(2, 0.2), estimate(4, 0.3), estimate(3, 0.4))
    assert water is not None
    np.testing.assert_array_equal(water.depth_m, [0, 1, 2, 3, 4, 5, 6])
    np.testing.assert_array_equal(water.sd_mps, [0.1, 0.1, 0.2, 0.4, 0.4, 0.4, 0.3])
    np.testing.assert_array_equal(water.north_mps, water.depth_m / 100)
    np.testing.assert_array_equal(water.east_mps, -water.depth_m / 100)


def test_the_shared_error_of_depths_is_the_velocitys_and_at_most_the_best_depths() -> None:
    loose, tight = heard(estimate(0, 0.1)), heard(estimate(0, 0.01), estimate(5, 0.1))
    assert loose is not None
    assert tight is not None
    assert loose.sd_common_mps == pytest.approx(0.03)
    assert tight.sd_common_mps == 0.01


def test_without_an_estimate_or_its_standard_deviations_nothing_was_learned() -> None:
    good = estimate(0, 0.1)
    for bad in (
        estimate(0, 0.1, known=False),
        msgspec.structs.replace(good, covariance=None),
        msgspec.structs.replace(good, current=None),
        msgspec.structs.replace(good, north_m=np.nan),
    ):
        assert heard(good, bad) is None
    assert heard() is None


def test_a_run_saves_its_last_profile_and_its_recording_yields_the_same(tmp_path: Path) -> None:
    here = run_config("run.duration_s=2", "run.seed=4")
    place = folder.make("descent", here.files, out=tmp_path / "run")
    lockstep_run.run(here, place)
    saved = read_prior(place.path / "currents.csv")
    end = [message for message in Recording(place.recording) if message.kind is Estimate][-1].typed()[0]
    assert isinstance(end, Estimate)
    assert end.current is not None
    _, again = summarise_recording(here, place.recording)
    assert again is not None
    for name in ("depth_m", "north_mps", "sd_mps"):
        np.testing.assert_array_equal(getattr(saved, name), getattr(end.current, name))
        np.testing.assert_array_equal(getattr(saved, name), getattr(again, name))
    assert again.sd_common_mps == saved.sd_common_mps


def test_the_saved_shared_error_is_the_filters_covariance_between_depths(first: Visit) -> None:
    """The mean covariance of two depths that were seen; what the file says of it comes from the velocity alone."""
    there = first
    shared = []
    for axis in (there.belief.layout.north, there.belief.layout.east):
        P = there.belief.P[axis, axis][5:25, 5:25]
        count = len(P)
        shared.append((P.sum() - np.trace(P)) / (count * (count - 1)))
    assert there.saved.sd_common_mps == pytest.approx(np.sqrt(max(shared)), rel=0.2)


# --- what is handed on --------------------------------------------------------------------------------------------


def test_the_estimator_starts_from_the_file_and_so_does_whoever_reads_its_estimates(first, tmp_path) -> None:
    """The shear of the first visit is in the second one's estimates before its own pings can have seen it."""
    write_profile(tmp_path / "known.csv", first.saved)
    settings = ("run.duration_s=0.1", "run.seed=9")
    informed = visit(run_config(*settings, f"estimator.water_prior={tmp_path / 'known.csv'}")).estimate.current
    alone = visit(run_config(*settings)).estimate.current
    assert informed is not None
    assert informed.sd_mps is not None
    assert alone is not None
    assert alone.sd_mps is not None
    deep = BELOW_FIRST_PING
    shear = np.diff(first.saved.north_mps[deep])
    np.testing.assert_allclose(np.diff(informed.north_mps[deep]), shear, atol=0.25 * np.abs(shear).max())
    assert np.abs(np.diff(alone.north_mps[deep]) - shear).max() > 0.5 * np.abs(shear).max()
    assert (informed.sd_mps[deep] < 0.5 * alone.sd_mps[deep]).all()


@pytest.mark.usefixtures("without_report")
def test_the_folder_holds_prior_and_currents_and_runs_again_without_the_files_they_came_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = "# mine\ndepth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n0,0.1,0,0.01,0\n60,0,0.1,0.01,0\n"
    Path("sea").mkdir()
    Path("sea/known.csv").write_text(text)
    # The file's own table and the option name it from where each stands.
    text_of_scenario = 'title = "x"\n[run]\nsurface_time_s = 1.0\n[estimator]\nwater_prior = "known.csv"\n'
    Path("sea/mine.toml").write_text(text_of_scenario)
    Path("sea/now.csv").write_text("depth_m,v_north_mps,u_east_mps\n1,0.05,0\n20,0,0.05\n")
    line = "--lockstep --duration-s 0.5 --sensors realistic"
    assert run(f"sim sea/mine.toml {line} --out a".split()) == 0
    assert run(f"sim descent {line} --water-prior sea/known.csv --currents sea/now.csv --out b".split()) == 0
    Path("sea").rename("elsewhere")
    for name in ("a", "b"):
        assert Path(name, "config/water-prior.csv").read_text() == text
        assert 'water_prior = "water-prior.csv"' in Path(name, "config/estimator.toml").read_text()
        Path(name).rename(f"moved-{name}")
        assert run(f"sim moved-{name}/scenario.toml --lockstep --out again-{name}".split()) == 0
        assert Path(f"again-{name}/run.mcap").read_bytes() == Path(f"moved-{name}/run.mcap").read_bytes()


def test_the_process_reads_the_prior_beside_its_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The prior that a settings file names stands beside that file, whatever the working directory."""
    one = np.ones(1)
    known = WaterPrior(depth_m=one, north_mps=one / 3, east_mps=one, sd_mps=one, sd_common_mps=0.25)
    write_profile(tmp_path / "known.csv", known)
    (tmp_path / "estimator.toml").write_text('water_prior = "known.csv"\n')
    (tmp_path / "none.toml").write_text("cell_m = 2.0\n")
    given: list[WaterPrior | None] = []

    def main(config: process.Config) -> int:
        given.append(load_prior(config.loaded()))
        return 0

    monkeypatch.setattr(process, "main", main)
    assert run(["estimator", "--settings", str(tmp_path / "estimator.toml")]) == 0
    assert run(["estimator", "--settings", str(tmp_path / "none.toml")]) == 0
    assert run(["estimator"]) == 0
    assert given[0] is not None
    assert (given[0].north_mps[0], given[0].sd_common_mps) == (1 / 3, 0.25)
    assert given[1:] == [None, None]


# --- what it is good for ------------------------------------------------------------------------------------------


def test_a_place_seen_before_makes_the_velocity_surer_and_no_surer_than_it_is(first: Visit, tmp_path: Path) -> None:
    """The same water, other sensor errors: the first visit's surface fix is there for the second one too.

    Drift itself is luck; over ten of 200 s it fell by a third, as the velocity's error does.
    """
    write_profile(tmp_path / "known.csv", first.saved)
    write_profile(tmp_path / "true.csv", run_config(DURATION, "run.seed=0").water.profile(0))
    again = (DURATION, "run.seed=100", "water.kind=measured", f"water.file={tmp_path / 'true.csv'}")
    prior = (f"estimator.water_prior={tmp_path / 'known.csv'}", "estimator.water_prior_change_sd_mps=0")
    sd = {}
    for name, settings in (("alone", again), ("told", (*again, *prior))):
        there = visit(run_config(*settings))
        assert there.estimate.covariance is not None
        assert there.estimate.t_ns == there.truth.t_ns
        estimated = np.array([there.estimate.velocity_north_mps, there.estimate.velocity_east_mps])
        error, P = estimated - there.truth.velocity_mps[:2], there.estimate.covariance[2:4, 2:4]
        assert error @ np.linalg.solve(P, error) < 13.8  # chi-square, 2 degrees of freedom: 99.9 %
        sd[name] = np.sqrt(P.trace())
    # Two fixes of equal worth, each of TDCP's 5 mm/s: 0.71 of one's error, and a little for what each dive adds.
    assert 0.65 < sd["told"] / sd["alone"] < 0.85
