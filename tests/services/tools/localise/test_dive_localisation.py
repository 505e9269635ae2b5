"""Command for recorded dives: report, files and errors."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc.currents import read_prior
from ltv_mpc.errors import ConfigError
from services.cli.dives import localise as command
from services.tools.localise import dive_localisation
from services.tools.localise.dive_localisation import COLUMNS, localise
from services.tools.localise.text import text as dive_text
from tests.recorded.glider import World, dive
from tests.recorded.pd0_writer import BEAM, EARTH, Head, Written, to_earth, written


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a whole dive of a glider, down and up."""
    path = tmp_path_factory.mktemp("dive") / "dive.PD0"
    path.write_bytes(dive(World(), 5, duration=480.0).data)
    return path


@pytest.fixture(scope="module")
def out(made: Path) -> Path:
    """Return the folder of the command for all of it; ``printed`` in it has its standard output."""
    folder = made.parent / "out"
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert command(made, out=folder, as_json=True) == 0
    (made.parent / "printed").write_text(printed.getvalue())
    return folder


@pytest.fixture(scope="module")
def whole(out: Path) -> dict[str, Any]:
    """Return the result for all of it."""
    result: dict[str, Any] = json.loads((out / "localise.json").read_text())
    return result


@pytest.fixture(autouse=True)
def few_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Study three starts of a dive, but all of the one above."""
    monkeypatch.setattr(dive_localisation, "MAX_STARTS", 3)


def small(count: int = 12, *, gap_s: float = 0.0, bottom: bool = True) -> bytes:
    """Return a few ensembles of noise, with ``gap_s`` in the middle."""
    rng = np.random.default_rng(1)
    head = Head(cells=4, coordinates=BEAM)
    frames = [
        written(
            head,
            Written(
                t_s=4.0 * k + gap_s * (2 * k >= count),
                beams_mps=0.02 * rng.standard_normal((4, 4)),
                depth_m=0.5 * k,
                number=k + 1,
                bottom_beams_mps=np.zeros(4) if bottom else None,
            ),
        )
        for k in range(count)
    ]
    return b"".join(frames)


def written_to(folder: Path, data: bytes) -> Path:
    path = folder / "small.PD0"
    path.write_bytes(data)
    return path


def test_json_has_the_result_alone_and_its_figures_agree_with_one_another(out: Path, whole: dict[str, Any]) -> None:
    assert json.loads((out.parent / "printed").read_text()) == whole
    assert whole["ensembles"] > 100
    assert (whole["lost_bytes"], whole["losses"], whole["surface_fixes"]) == (0, [], 10)
    assert whole["track"]["fixes"] == 10
    study = whole["study"]
    errors = [each["error_m"] for each in study["each"]]
    assert study["starts"] == len(errors) >= 8
    assert study["median_error_m"] == np.median(errors)
    assert study["ratio"] == pytest.approx(study["median_error_m"] / study["median_constant_velocity_error_m"])
    assert study["inside_3_sigma"] == np.mean([each["inside_3_sigma"] for each in study["each"]])
    assert all(300 <= each["after_s"] < 310 and 2 <= each["depth_m"] <= 14 for each in study["each"])
    assert 300 <= whole["error"]["after_s"] < 310
    assert whole["parameters"]["gate_probability"] == 0.999


def test_the_folder_holds_result_track_current_and_picture(out: Path, whole: dict[str, Any], tmp_path: Path) -> None:
    assert {path.name for path in out.iterdir()} == {"currents.csv", "localise.html", "localise.json", "track.csv"}
    with (out / "track.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == whole["track"]["ensembles"]
    assert float(rows[-1]["north_m"]) == pytest.approx(whole["track"]["end_north_m"], abs=1e-3)
    assert float(rows[-1]["sigma_m"]) == pytest.approx(whole["track"]["end_sigma_m"], abs=1e-3)
    water = read_prior(out / "currents.csv")
    assert water.depth_m[0] <= 2
    assert water.depth_m[-1] > 50
    assert "Position error against bottom track" in (out / "localise.html").read_text(encoding="utf-8")
    with pytest.raises(ConfigError, match="--force"):
        command(written_to(tmp_path, small()), out=out)


def test_the_start_is_the_first_ensemble_at_the_depth(made: Path, whole: dict[str, Any]) -> None:
    result = localise(made, start_depth_m=9.0).result
    assert 9.0 <= result.track.start_depth_m < 9.7
    assert result.track.ensembles < whole["track"]["ensembles"]
    assert list(msgspec.to_builtins(result.study)["each"]) == whole["study"]["each"][:3]
    with pytest.raises(ConfigError, match="the deepest is at 41") as error:
        localise(made, start_depth_m=60.0)
    assert error.value.source == "option --start-depth-m"


def test_without_fixes_there_is_a_track_and_no_constant_velocity(made: Path) -> None:
    text = dive_text(localise(made, fixes=0).result)
    assert "constant velocity unknown" in text
    assert "no fix by bottom track" in text


def test_without_bottom_track_there_is_a_track_and_nothing_to_compare_it_with(tmp_path: Path) -> None:
    outcome = localise(written_to(tmp_path, small(bottom=False)))
    assert outcome.result.error is outcome.result.study is None
    assert outcome.result.track.fixes == 0
    assert any("no bottom track in the dive" in note for note in outcome.result.notes)
    assert np.isnan(outcome.truth_m).all()
    assert np.isfinite(outcome.track.position_m).all()


def test_a_long_gap_and_another_instrument_end_the_dive(tmp_path: Path) -> None:
    result = localise(written_to(tmp_path, small(gap_s=500.0))).result
    assert (result.ensembles, result.track.ensembles) == (12, 6)
    assert "a gap of 504 s follows" in result.notes[0]
    assert localise(written_to(tmp_path, small(gap_s=100.0))).result.track.ensembles == 12
    head = Head(frequency_kHz=300, cells=5, coordinates=BEAM)
    other = written(head, Written(t_s=100.0, beams_mps=np.zeros((5, 4)), bottom_beams_mps=np.zeros(4)))
    result = localise(written_to(tmp_path, small() + other)).result
    assert (result.ensembles, result.track.ensembles) == (13, 12)
    assert "another instrument follows" in result.notes[0]


def lawnmower(
    seed: int, *, speed: float = 1.5, turn_deg_s: float = 12.0, dt: float = 4.0, **head: Any
) -> list[Written]:
    """Return a dive at constant depth and speed: legs of 60 s with half a turn between them, in a uniform current."""
    rng, current = np.random.default_rng(seed), np.array([0.1, 0.05])
    made, beams = Head(coordinates=EARTH, cells=10, cell_cm=50, first_cm=117, pings=4, **head), []
    s, c = math.sin(math.radians(30)), math.cos(math.radians(30))
    from_instrument = np.array([[-s, 0, -c], [s, 0, -c], [0, s, -c], [0, -s, -c]])
    turn_s = 180.0 / turn_deg_s
    for k in range(round(420.0 / dt)):
        legs, into = divmod(k * dt, 60.0 + turn_s)
        turned = (legs + max(into - 60.0, 0.0) / turn_s) % 2
        heading = 180.0 * (turned if turned <= 1.0 else 2.0 - turned)
        through = speed * np.array([math.cos(math.radians(heading)), math.sin(math.radians(heading))])
        enu = from_instrument @ to_earth(made, heading, 0.0, 0.0).T
        beams.append(
            Written(
                t_s=round(k * dt, 2),
                beams_mps=np.tile(enu @ [through[1], through[0], 0.0], (10, 1)) + 0.03 * rng.standard_normal((10, 4)),
                heading_deg=heading,
                depth_m=10.0,
                number=k + 1,
                bottom_beams_mps=enu @ [*(through + current)[::-1], 0.0],
                bottom_range_m=np.full(4, 30.0),
                echo=np.tile(np.linspace(110, 80, 10)[:, None], 4),
            )
        )
    return beams


def of_lawnmower(folder: Path, ensembles: list[Written]) -> Path:
    return written_to(folder, b"".join(framed(ensembles)))


def framed(ensembles: list[Written], **head: Any) -> list[bytes]:
    made = Head(coordinates=EARTH, cells=10, cell_cm=50, first_cm=117, pings=4, **head)
    return [written(made, ensemble) for ensemble in ensembles]


@pytest.mark.parametrize(("seed", "of"), [(1, {"speed": 2.5, "turn_deg_s": 6.0}), (2, {"turn_deg_s": 3.0, "dt": 8.0})])
def test_a_vehicle_that_turns_is_localised_and_the_filter_is_consistent(seed, of, tmp_path, monkeypatch) -> None:
    """With one random walk for every vehicle, wide enough for a glider, the error was 104 m at a sigma of 5.8 m."""
    monkeypatch.setattr(dive_localisation, "MAX_STARTS", 10)
    result = localise(of_lawnmower(tmp_path, lawnmower(seed, **of))).result
    assert result.error is not None
    assert result.error.error_m < 4.0
    assert result.error.sigma_m < 12.0
    assert result.study is not None
    assert result.study.inside_3_sigma == 1.0
    assert not any("NOT consistent" in note for note in result.notes)


def test_a_filter_whose_sigma_is_too_small_says_so(tmp_path: Path) -> None:
    ensembles = lawnmower(1)
    for k, ensemble in enumerate(ensembles):
        ensemble.beams_mps += 0.3 * (-1.0) ** k * np.linspace(-1.0, 1.0, 10)[:, None] * [1.0, -1.0, 1.0, -1.0]
    notes = localise(of_lawnmower(tmp_path, ensembles)).result.notes
    assert any("NOT consistent" in note and "where 1 is expected" in note for note in notes)


@pytest.mark.parametrize("measured", [0, 7])
def test_an_error_velocity_that_was_filled_in_is_no_noise(measured: int, tmp_path: Path) -> None:
    """The beams then agree to the last bit, and the noise would be that of the data sheet."""
    ensembles = lawnmower(1)
    for ensemble in ensembles[measured:]:
        spare = ensemble.beams_mps @ [0.25, 0.25, -0.25, -0.25]
        ensemble.beams_mps -= spare[:, None] * [1.0, 1.0, -1.0, -1.0]
    result = localise(of_lawnmower(tmp_path, ensembles)).result
    assert result.instrument.beam_sd_mps == pytest.approx(2.0 * 0.0388, rel=0.01)


def test_one_ensemble_with_a_clock_a_day_ahead_costs_one_ensemble(tmp_path: Path) -> None:
    ensembles = lawnmower(1)
    ensembles[40].t_s += 86_400.0
    result = localise(of_lawnmower(tmp_path, ensembles)).result
    assert (result.ensembles, result.track.ensembles) == (104, 104)
    assert [loss.why for loss in result.losses] == ["its clock does not increase"]


def test_of_two_heads_one_is_used(tmp_path: Path) -> None:
    down, up = framed(lawnmower(1)), framed(lawnmower(1, upward=True), upward=True)
    path = written_to(tmp_path, b"".join(b for pair in zip(down, up[:-1], strict=False) for b in pair) + down[-1])
    result = localise(path).result
    assert (result.ensembles, result.track.ensembles, result.instrument.looks) == (105, 105, "down")
    assert "two heads: 105 ensembles look down and are used, 104 look up (--head up)" in result.notes
    assert localise(path, head="up").result.instrument.looks == "up"
    with pytest.raises(ConfigError, match="option --head"):
        localise(written_to(tmp_path, b"".join(down)), head="up")


def test_an_instrument_that_changes_its_cells_is_followed(whole: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "adapted.PD0"
    path.write_bytes(dive(World(adapts=True), 5, duration=480.0).data)
    result = localise(path).result
    assert result.track.ensembles == whole["track"]["ensembles"]
    assert any("2 setups" in note for note in result.notes)
    assert result.error is not None
    assert result.error.inside_3_sigma
    assert result.error.error_m < result.error.constant_velocity_error_m
    assert result.track.cells_used > 1.3 * whole["track"]["cells_used"]
    assert result.track.nis == pytest.approx(whole["track"]["nis"], rel=0.5)


@pytest.mark.parametrize("amplitude_mps", [0.0, 0.3])
def test_water_that_is_not_uniform_is_said_and_widens_sigma(amplitude_mps: float, tmp_path: Path) -> None:
    """A run over the waves of a river's current: without the widening its error is 16 sigma."""
    path, made = tmp_path / "river.PD0", dive(World(speed=1.0, fall=0.0, bottom_m=20.0, river=amplitude_mps), 10)
    path.write_bytes(made.data)
    outcome = localise(path)
    water, track = outcome.result.water, outcome.track
    assert water is not None
    assert water.uniform is (amplitude_mps == 0.0)
    assert ("NOT horizontally uniform" in dive_text(outcome.result)) is not water.uniform
    error = track.position_m[-1] - (made.position[-1] - made.position[0])
    assert error @ np.linalg.solve(track.position_covariance[-1], error) <= 9.0


def test_damage_is_said_with_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = bytearray(small())
    data[len(data) // 12 * 3 + 50] ^= 0xFF
    path = written_to(tmp_path, bytes(data[:-10]))
    assert command(path) == 0
    out = capsys.readouterr().out
    assert "10 ensembles" in out
    assert f"byte {len(data) // 12 * 3}: {len(data) // 12} bytes: the ensemble at byte" in out
    assert "in 2 places" in out
