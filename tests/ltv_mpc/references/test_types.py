"""Reference files: the shipped ones, errors, and feasibility notes."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from ltv_mpc import Estimate, config, references
from ltv_mpc.errors import ConfigError
from ltv_mpc.references import Hold, Line, Place, Point, Reference, Spiral, Timed, Waypoints
from ltv_mpc.vehicle.parameters import Vehicle

PAPER = Vehicle.load("paper")
EXAMPLES = Path(__file__).parents[3] / "examples" / "references"
SHIPPED = ("descent", "hover", "line", "square", "lawnmower", "circle", "spiral")


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_file_is_read_and_written_back_the_same(name):
    reference = references.load(name)
    again = config.parse(tomllib.loads(config.to_toml(reference)), Reference, source="x")
    assert again == reference
    assert all(isinstance(note, str) for note in reference.notes(PAPER))


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
def test_an_example_is_read_and_followed(path):
    reference = references.load(str(path))
    assert reference.schedule(PAPER).duration_s > 10.0


HERE = "north_m=1, east_m=1"
SPIRAL = f"kind = 'spiral'\nspeed_mps = 1\nspacing_m = 1\ncentre = {{{HERE}}}\n"
MOWER = f"kind = 'lawnmower'\nspeed_mps = 1\ncourse_deg = 0\nlength_m = 5\nstart = {{{HERE}}}\n"
FIRST = "kind = 'waypoints'\nspeed_mps = 1\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("kind = 'line'\nspeed_mps = 1", 'key "start" is missing: must be a table with north_m,'),
        (f"{FIRST}waypoints = [{{north_m = 1, east_m = 1}}]", "waypoints = "),
        (f"{FIRST}waypoints = [{{north_m = 1, east_m = 1}}, {{north_m = 1}}]", "waypoints[1]: a position needs"),
        (f"{FIRST}waypoints = [{{north_m = 1, east_m = 1}}, {{north_m = 1, east_m = 1}}]", "are the same position"),
        (f"{FIRST}laps = 2\nwaypoints = [{{north_m=1, east_m=1}}, {{north_m=2, east_m=1}}]", "needs closed = true"),
        (
            f"{FIRST}depth_m = 1\nwaypoints = [{{{HERE}, depth_m = 2}}, {{north_m=2, east_m=1}}]",
            "depth_m is given for the whole path and for places on it",
        ),
        (f"{SPIRAL}inner_m = 5\nouter_m = 4", "outer_m = 4: must be > inner_m = 5"),
        (f"{SPIRAL}inner_m = 0\nouter_m = 400", "must be <= 100 turns"),
        (f"{MOWER}width_m = 20\nspacing_m = 5e-324", "width_m / spacing_m must be <= "),
        ("kind = 'timed'", "give either file"),
        ("kind = 'timed'\nrows = [[0, 0, 0]]", "rows: at least 2"),
        ("kind = 'timed'\nrows = [[0, 0, 0], [1, 1, 1, 1]]", "all with the same number of columns"),
        ("kind = 'timed'\nrows = [[0, 0, 0], [0, 1, 1]]", "rows[1] t_s = 0: must be later than the row before it, 0 s"),
        ("kind = 'timed'\nrows = [[0, 0, 0], [1, 2e6, 1]]", "rows[1] north_m = 2e+06: must be >= -1e+06 and <= 1e+06"),
    ],
)
def test_an_error_names_its_field_and_bound(text, says):
    with pytest.raises(ConfigError) as error:
        config.parse(tomllib.loads(text), Reference, source="reference r.toml")
    assert str(error.value).startswith("reference r.toml: ")
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("csv", "says"),
    [
        ("t_s,north_m\n0,0\n1,1", "missing column east_m"),
        ("t_s,north_m,east_m\n0,0,0", "needs a header and at least 2 rows"),
        ("# t\nt_s,north_m,east_m\n1,0,0\n1,1,0", "line 4 t_s = 1.0: must be later than the row before it, 1 s"),
        ("t_s,north_m,east_m\n0,0,0\n1,1e7,0", "line 3 north_m = 1e+07: must be >= -1e+06 and <= 1e+06"),
        ("t_s,latitude_deg,longitude_deg\n0,0,0\n1,1,0", "need an [origin]"),
    ],
)
def test_an_error_in_a_track_names_file_line_and_column(tmp_path, csv, says):
    (tmp_path / "r.toml").write_text("kind = 'timed'\nfile = 'track.csv'")
    (tmp_path / "track.csv").write_text(csv)
    with pytest.raises(ConfigError, match=r"track\.csv") as error:
        references.load(str(tmp_path / "r.toml"))
    assert says in str(error.value)


def test_a_track_file_is_in_the_references_folder_with_columns_in_any_order(tmp_path):
    (tmp_path / "r.toml").write_text("kind = 'timed'\nfile = 'track.csv'")
    (tmp_path / "track.csv").write_text(
        "# a track\ndepth_m, east_m, note, t_s, north_m\n1, 2, x, 3, 4\n5, 6, y, 7, 8\n"
    )
    reference = references.load(str(tmp_path / "r.toml"))
    assert reference == Timed(rows=((3.0, 4.0, 2.0, 1.0), (7.0, 8.0, 6.0, 5.0)))


def test_a_feasible_track_keeps_its_times_and_another_is_late_where_it_must_be():
    slow = Timed(rows=((0.0, 0.0, 0.0), (50.0, 10.0, 0.0), (60.0, 10.0, 0.0), (110.0, 20.0, 0.0)))
    np.testing.assert_allclose(slow.schedule(PAPER).table[0], [0.0, 50.0, 60.0, 110.0])
    assert slow.notes(PAPER) == []
    fast = Timed(rows=((0.0, 0.0, 0.0), (10.0, 10.0, 0.0), (60.0, 20.0, 0.0)))
    late = 10.0 / (0.5 * 0.8**0.5) - 10.0  # 10 m in 10 s, at 0.447 m/s
    assert fast.schedule(PAPER).table[0] == pytest.approx([0.0, 10.0 + late, 60.0], abs=0.05)
    (note,) = fast.notes(PAPER)
    assert f"the first at t_s = 10; the latest by {late:.1f} s, the last by 0.0 s" in note


@pytest.mark.parametrize(("first_s", "delay_s"), [(60.0, 0.0), (0.0, 15.4)])
def test_a_track_begins_at_its_time_or_as_soon_as_the_vehicle_can_be_there(first_s, delay_s):
    """The first row is 5 m away, 15.4 s from rest to rest."""
    track = Timed(rows=((first_s, 0.0, 5.0), (first_s + 40.0, 6.0, 5.0)))
    schedule = track.schedule(PAPER, Hold().anchor(Estimate.at_rest()))
    time, way = schedule.table[:2]
    assert (time[0], schedule.lead_m) == (0.0, 5.0)
    assert np.interp([5.0, 11.0], way, time) == pytest.approx(first_s + delay_s + np.array([0.0, 40.0]), abs=0.1)


def test_notes_name_what_is_not_feasible_and_nothing_else():
    square = references.load("square")
    speed, corners, time = square.notes(PAPER)
    assert speed.startswith("speed_mps = 1 is reduced to 0.45 m/s")
    assert corners.startswith("3 corners of up to 90 degrees: speed reduced to 0.2")
    assert "instead of 79 s" in time
    there = Place(north_m=40.0, east_m=0.0)
    assert Line(speed_mps=0.4, start=Place(north_m=0.0, east_m=0.0), end=there).notes(PAPER) == []
    assert Hold(depth_m=10.0, descent_rate_mps=0.2).notes(PAPER) == []
    (deep,) = Point(north_m=0.0, east_m=0.0, depth_m=10.0, descent_rate_mps=0.5).notes(PAPER)
    assert deep.startswith("descent_rate_mps = 0.5 takes 230 N")  # 800 x 0.5^2 + 30.5 N of buoyancy
    tight = Spiral(speed_mps=0.4, centre=Place(north_m=0.0, east_m=0.0), inner_m=0.5, outer_m=4.0, spacing_m=1.0).notes(
        PAPER
    )
    assert tight[0].startswith("bends of 0.49 m radius")
    slope = Line(
        speed_mps=0.4,
        start=Place(north_m=0.0, east_m=0.0, depth_m=0.0),
        end=Place(north_m=9.0, east_m=0.0, depth_m=9.0),
    )
    assert slope.notes(PAPER)[0].startswith("depth changes faster than descent_rate_mps = 0.2: speed reduced to 0.20")
    sharp = Waypoints(
        speed_mps=0.4, corner_m=0.0, waypoints=(Place(north_m=0.0, east_m=0.0), there, Place(north_m=40.0, east_m=9.0))
    ).notes(PAPER)
    assert sharp[0].startswith("1 corner of up to 90 degrees not rounded: the vehicle stops there and turns, 8.1 s")
