"""Bathymetry: what a file says between its soundings and beyond them, and errors that name line, column and bound."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ltv_mpc.bathymetry import Bathymetry, bathymetry_for
from ltv_mpc.control.config import MotionLimits
from ltv_mpc.errors import ConfigError
from ltv_mpc.references import Line, Place, Point
from ltv_mpc.references.geodesy import Origin, tangent_plane
from ltv_mpc.vehicle.parameters import Vehicle
from services.tools.mission_check import check_bottom

HEADER = "north_m,east_m,depth_m\n"
SQUARE = HEADER + "0,0,10\n0,100,10\n100,0,30\n100,100,30\n"


def read(folder: Path, text: str, origin: Origin | None = None) -> Bathymetry:
    (folder / "bottom.csv").write_text(text)
    return Bathymetry.load(str(folder / "bottom.csv"), origin)


def depths(bathymetry: Bathymetry, *places: tuple[float, float]) -> list[float]:
    return bathymetry.depths(np.array(places)).tolist()


def test_the_bottom_is_linear_between_soundings(tmp_path: Path) -> None:
    found = depths(read(tmp_path, SQUARE), (0.0, 50.0), (25.0, 40.0), (50.0, 90.0), (100.0, 3.0))
    assert found == pytest.approx([10.0, 15.0, 20.0, 30.0])


def test_beyond_the_soundings_the_bottom_is_not_known(tmp_path: Path) -> None:
    assert np.isnan(depths(read(tmp_path, SQUARE), (-0.1, 50.0), (50.0, 100.1), (1e6, 1e6))).all()


def test_of_two_soundings_at_one_place_the_shallower_counts(tmp_path: Path) -> None:
    for again in ("0,0,4\n", "0.0004,0,4\n"):
        assert depths(read(tmp_path, SQUARE + again), (0.0, 0.0)) == [4.0]
        assert depths(read(tmp_path, HEADER + again + SQUARE.removeprefix(HEADER)), (0.0, 0.0)) == [4.0]
    assert depths(read(tmp_path, SQUARE + "0,0,14\n"), (0.0, 0.0)) == [10.0]


def test_a_drying_height_is_land_above_the_surface(tmp_path: Path) -> None:
    bank = read(tmp_path, HEADER + "0,0,-2\n0,100,8\n100,0,8\n")
    assert depths(bank, (0.0, 0.0), (0.0, 50.0)) == pytest.approx([-2.0, 3.0])
    over = Line(start=Place(north_m=1.0, east_m=1.0), end=Place(north_m=1.0, east_m=90.0), speed_mps=0.3, depth_m=0.0)
    bottom, problems = check_bottom(bank, over.schedule(Vehicle.load("paper")), 0.0)
    assert bottom is not None
    assert bottom.altitude_m == pytest.approx(-1.8)
    assert problems[0].startswith("the reference is too deep for")


def test_degrees_are_relative_to_the_origin_of_the_reference(tmp_path: Path) -> None:
    origin = Origin(latitude_deg=50.0, longitude_deg=-5.0)
    corners = [(50.0, -5.0, 10.0), (50.001, -5.0, 30.0), (50.0, -4.999, 10.0)]
    text = "latitude_deg,longitude_deg,depth_m\n" + "".join(f"{a},{b},{z}\n" for a, b, z in corners)
    north, _ = tangent_plane(50.001, -5.0, origin)
    (tmp_path / "bottom.csv").write_text(text)
    reference = Point(north_m=0.0, east_m=0.0, origin=origin)
    found = bathymetry_for(reference, MotionLimits(min_altitude_m=1.0), str(tmp_path / "bottom.csv"))
    assert found is not None
    assert depths(found, (0.5 * north, 0.0)) == pytest.approx([20.0], abs=1e-3)
    with pytest.raises(ConfigError, match=r"need an \[origin\]"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("north_m,east_m\n0,0\n1,1\n2,3\n", "missing column depth_m; the header must name depth_m, north_m, east_m"),
        ("latitude_deg,depth_m\n0,0\n1,1\n2,3\n", "missing column longitude_deg"),
        (HEADER + "0,0,1\n0,1,1\n", "needs a header and at least 3 rows of numbers"),
        (HEADER + "0,0,1\n\n0,1,-400\n1,0,1\n", "line 4 depth_m = -400: must be >= -100 and <= 11000"),
        (HEADER + "0,0,1\n0,1e7,4\n1,0,1\n", "line 3 east_m = 1e+07: must be >= -1e+06 and <= 1e+06"),
        (HEADER + "0,0,1\n1,1,1\n2,2,1\n", "needs three soundings that are not in one line"),
        (HEADER + "0,0,1\n" * 8, "has 8 rows: at most 7"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_an_error_names_file_line_column_and_bound(
    tmp_path: Path, text: str, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ltv_mpc.bathymetry.MAX_SOUNDINGS", 7)
    with pytest.raises(ConfigError, match=r"bathymetry .*bottom\.csv") as error:
        read(tmp_path, text)
    assert says in str(error.value)


def test_a_bathymetry_needs_a_least_altitude(tmp_path: Path) -> None:
    reference = Point(north_m=0.0, east_m=0.0)
    assert bathymetry_for(reference, MotionLimits(), "") is None
    with pytest.raises(ConfigError, match=r"\[limits\] min_altitude_m: is missing"):
        bathymetry_for(reference, MotionLimits(), str(tmp_path / "bottom.csv"))
