"""Commands ``vehicle new``, ``check`` and ``identify``."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from ltv_mpc import Vehicle
from ltv_mpc.vehicle import parameters
from services.cli.app import run
from services.tools import vehicle_check

PAPER = (Path(parameters.__file__).parent / "files" / "paper.toml").read_text()


@pytest.fixture(autouse=True, scope="module")
def check_of_a_vehicle_once() -> Iterator[None]:
    """Compute what of a check depends on the vehicle alone once for each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(vehicle_check, "check", functools.cache(vehicle_check.check))
        yield


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_new_file_loads_and_gives_no_warning(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["vehicle", "new", "mine.toml"]) == 0
    assert "ltv-mpc vehicle check mine.toml" in capsys.readouterr().out
    assert Vehicle.load(str(here / "mine.toml")).name == "mine"
    assert run(["vehicle", "check", "mine.toml"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("mine (dives)")
    assert out.rstrip().endswith("no warnings")


def test_an_existing_file_is_not_replaced_without_force(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "mine.toml").write_text("precious")
    assert run(["vehicle", "new", "mine.toml"]) == 2
    assert "exists already: name another, or add --force" in capsys.readouterr().err
    assert (here / "mine.toml").read_text() == "precious"
    assert run(["vehicle", "new", "mine.toml", "--force"]) == 0
    assert (here / "mine.toml").read_text() != "precious"


def test_the_proposed_horizon_covers_a_turn_and_a_stop(capsys: pytest.CaptureFixture[str]) -> None:
    """Half a turn of a vehicle that is much slower astern: the horizon is more than 1.9 times its duration."""
    assert run(["vehicle", "check", "weak-reverse", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    can = said["performance"]
    both = can["turn_90deg_s"] + can["stopping_time_s"]
    assert both + 3.0 < said["horizon_s"] < 2.0 * both
    assert said["horizon_s"] > 1.9 * said["time_scale_s"] + 0.31


@pytest.mark.usefixtures("without_report")
def test_identify_recovers_the_vehicle_of_a_run(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A vehicle with 1.2 times the mass and 0.8 times the drag, held in a current for half a minute."""
    keys = (
        *("run.duration_s=30", "run.surface_time_s=1", "water.sd_mps=0.15", "plant.north_m=3"),
        *("plant.mismatch.mass=1.2", "plant.mismatch.drag=0.8"),
    )
    options = [word for key in keys for word in ("--set", key)]
    assert run(["sim", "hover", "--lockstep", "--perfect-state", "--out", "run", *options]) in (0, 1)
    capsys.readouterr()
    assert run(["vehicle", "identify", "run", "--out", "found.toml", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["input"] == "applied"
    found = {one["name"]: one["value"] for one in said["coefficients"]}
    assert found["mass_surge"] == pytest.approx(600.0, rel=0.05)
    assert found["inertia_yaw"] == pytest.approx(1.2 * 179.049, rel=0.02)
    assert found["linear_yaw"] == pytest.approx(12.0, rel=0.1)
    better = Vehicle.load(str(here / "found.toml"))
    assert better.surge.mass_kg == pytest.approx(found["mass_surge"])
    assert better.sway.quadratic_damping_kgpm == pytest.approx(found["quadratic_sway"])
    assert all(one["value"] == one["file"] for one in said["coefficients"] if not one["excited"])
    assert max(map(abs, said["current_mps"])) < 0.02  # the estimates contain the current
    assert better.thruster.port.max_N == 62.5
    assert said["warnings"] == []
    # The estimates are those of the origin: a point that the file declares is kept, and the contradiction is printed.
    (here / "antenna.toml").write_text(PAPER + "[reference_point]\nforward_m = 1.0\n")
    recording = str(here / "run" / "run.mcap")
    assert run(["vehicle", "identify", recording, "--vehicle", "antenna.toml", "--out", "kept.toml"]) == 0
    assert Vehicle.load(str(here / "kept.toml")).reference_point.forward_m == 1.0
    contradiction = "warning: the log contradicts the declared reference_forward = 1 m: its 95 % interval is "
    out = capsys.readouterr().out
    assert contradiction in out
    assert "mass_surge" in out
    assert f"# {contradiction}" in (here / "kept.toml").read_text()
    # a file that is there is kept, before the run is read
    assert run(["vehicle", "identify", "run", "--out", "found.toml"]) == 2


def test_check_says_what_of_a_mission_cannot_be_and_exits_with_1(here, capsys) -> None:
    (here / "fence.toml").write_text(
        'margin_m = 1.0\n[[keep_out_disc]]\nname = "buoy"\ncentre = { north_m = 0.0, east_m = 0.0 }\nradius_m = 3.0\n'
    )
    assert run(["vehicle", "check", "paper", "--reference", "circle", "--fence", "fence.toml", "--current", "0.1"]) == 1
    assert 'keep_out_disc[0] "buoy"' in capsys.readouterr().out
    assert run(["vehicle", "check", "paper", "--reference", "descent", "--bottom", "500", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mission"]["problems"] == []
    (here / "water.csv").write_text("depth_m;v_north_mps;u_east_mps\n20;0,03;0,04\n0;0,01;0\n")
    assert run(["vehicle", "check", "paper", "--reference", "descent", "--current", "water.csv", "--json"]) == 0
    mission = json.loads(capsys.readouterr().out)["mission"]
    assert mission["current_mps"] == pytest.approx(0.05)
    assert mission["notes"][0].endswith("the depths descend in the file")
    assert mission["notes"][1].endswith("0 to 20 m, the strongest 0.05 m/s")
    assert run(["vehicle", "check", "paper", "--reference", "descent", "--current", "5.1"]) == 2
    assert "option --current: " in capsys.readouterr().err
    (here / "bottom.csv").write_text("north_m,east_m,depth_m\n-50,-50,9\n-50,50,9\n50,-50,9\n50,50,9\n")
    (here / "line.toml").write_text(
        'kind = "line"\nspeed_mps = 0.3\ndepth_m = 8.0\nstart = { north_m = 0, east_m = 0 }\n'
        "end = { north_m = 40, east_m = 0 }\n"
    )
    (here / "mine.toml").write_text("[limits]\nmin_altitude_m = 2.0\n")
    check = ["vehicle", "check", "paper", "--reference", "line.toml", "--bottom", "bottom.csv"]
    assert run(check) == 0
    assert "altitude of the reference             1 m or more" in capsys.readouterr().out
    assert run([*check, "--settings", "mine.toml"]) == 1
    assert "by up to 1.0 m" in capsys.readouterr().out
    assert run([*check[:-1], "-3"]) == 2
    assert "option --bottom" in capsys.readouterr().err
    assert run(["vehicle", "check", "paper", "--bottom", "bottom.csv"]) == 2
    assert "option --bottom: needs --reference" in capsys.readouterr().err
    assert run(["vehicle", "check", "paper", "--fence", "fence.toml"]) == 2
    assert "option --fence: needs --reference" in capsys.readouterr().err


def test_check_takes_the_start_of_the_vehicle_and_asks_for_it_here(here, capsys):
    (here / "fence.toml").write_text(
        "margin_m = 1.0\n[[keep_out_disc]]\ncentre = { north_m = 0.0, east_m = 0.0 }\nradius_m = 3.0\n"
    )
    (here / "point.toml").write_text('kind = "point"\nnorth_m = 20.0\neast_m = -1.0\n')
    check = ["vehicle", "check", "paper", "--fence", "fence.toml", "--reference"]
    for words, code, said in (
        (["descent"], 1, "--fence is not checked"),
        (["descent", "--start", "20,0"], 0, "no problems"),
        (
            ["point.toml", "--start", "1,-2.5"],
            1,
            "the start is not allowed: hull 1.36 m beyond the boundary of keep_out",
        ),
        (["point.toml", "--start", "-20,1"], 0, "note: the way from the start leads round the zones: 4"),
    ):
        assert run([*check, *words]) == code
        assert said in " ".join(capsys.readouterr().out.split())
    for text in ("3", "1,2,3", "1,nan", "1,1e9", "north,east"):
        assert run([*check, "descent", "--start", text]) == 2
        assert f'option --start: "{text}": must be NORTH,EAST in metres' in capsys.readouterr().err.replace(" = ", ": ")
