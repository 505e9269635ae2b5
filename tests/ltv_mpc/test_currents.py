"""Current profiles from CSV files: published ones, and all kinds of errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ltv_mpc.currents import WaterPrior, read_prior, read_profile, write_profile
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import CurrentProfile

GOOD = "depth_m,v_north_mps,u_east_mps\n0,0.1,-0.2\n10,0.3,0.4\n"


def read(tmp_path: Path, content: str) -> CurrentProfile:
    (tmp_path / "currents.csv").write_text(content, newline="")
    return read_profile(tmp_path / "currents.csv")


def columns(profile: CurrentProfile) -> list[list[float]]:
    return [column.tolist() for column in (profile.depth_m, profile.north_mps, profile.east_mps)]


@pytest.mark.parametrize(
    "content",
    [
        GOOD,
        "\ufeff" + GOOD,
        GOOD.replace("\n", "\r\n"),
        "u_east_mps,quality,depth_m,v_north_mps\n-0.2,good,0,0.1\n0.4,?,10,0.3\n",
        "# from a ship\n\ndepth_m , v_north_mps, u_east_mps\n# between\n 0, 0.1 ,-0.2\n10,0.3,0.4,,\n",
        "# depth_m,v_north_mps,u_east_mps  (from a glider, smoothed)\n0,0.1,-0.2\n10,0.3,0.4\n",
        "# these are depth_m, v_north_mps, u_east_mps\n" + GOOD,
        "# depth_m, v_north_mps, u_east_mps, in words\nv_north_mps,depth_m,u_east_mps\n0.1,0,-0.2\n0.3,10,0.4\n",
    ],
    ids=["plain", "bom", "crlf", "order", "comments", "header-in-comment", "prose", "comment-and-header"],
)
def test_a_profile_is_read_whatever_the_order_of_columns_and_the_comments(tmp_path, content):
    assert columns(read(tmp_path, content)) == [[0.0, 10.0], [0.1, 0.3], [-0.2, 0.4]]


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_tables_of_excel_are_read(tmp_path, encoding):
    (tmp_path / "c.csv").write_text("sep=;\ndepth_m;v_north_mps;u_east_mps;t (°C)\n0,5;0,1;0;7\n", encoding)
    np.testing.assert_array_equal(read_profile(tmp_path / "c.csv").depth_m, [0.5])


@pytest.mark.parametrize("separator", [";", "\t"])
def test_semicolons_and_tabs_separate_decimal_commas(tmp_path, separator):
    text = "depth_m;v_north_mps;u_east_mps\n0,5;0,11;-0,02\n1.5;0,12;3e-2\n".replace(";", separator)
    assert columns(read(tmp_path, text)) == [[0.5, 1.5], [0.11, 0.12], [-0.02, 0.03]]
    three = read(tmp_path, "depth_m;v_north_mps;u_east_mps\n1.000;0.110;2.000\n".replace(";", separator))
    np.testing.assert_array_equal(three.depth_m, [1.0])


def test_descending_depths_and_ends_without_a_current_are_read_with_a_note(tmp_path):
    rows = ["5,NaN,NaN", "10,0.05,0.03", "20,0.04,0.02", "30,nan,NA", "40,,"]
    for order in (rows, rows[::-1]):
        (tmp_path / "c.csv").write_text(HEADER + "\n".join(order))
        notes: list[str] = []
        profile = read_profile(tmp_path / "c.csv", notes)
        np.testing.assert_array_equal(profile.depth_m, [10.0, 20.0])
        np.testing.assert_array_equal(profile.north_mps, [0.05, 0.04])
        assert "rows without a current are left out at its ends, it has 10 to 20 m" in notes[0]
        assert ("the depths descend in the file" in notes[0]) == (order is not rows)


def test_what_is_written_is_read_back_bit_for_bit(tmp_path):
    draws = np.random.default_rng(2)
    depth, north, east = np.cumsum(draws.random(50)), draws.normal(0, 0.1, 50), draws.normal(0, 0.1, 50)
    sd = 0.01 + draws.random(50)
    plain = CurrentProfile(depth_m=depth, north_mps=north, east_mps=east)
    with_sd = CurrentProfile(depth_m=depth, north_mps=north, east_mps=east, sd_mps=sd)
    prior = WaterPrior(depth_m=depth, north_mps=north, east_mps=east, sd_mps=sd, sd_common_mps=0.1 / 30)
    path = tmp_path / "c.csv"
    for written, reader in (
        (plain, read_profile),
        (plain, CurrentProfile.load),
        (with_sd, read_profile),
        (prior, read_profile),  # the file of a prior is a profile too
        (prior, read_prior),
    ):
        write_profile(path, written)
        again = reader(path)
        for name in ("depth_m", "north_mps", "east_mps", "sd_mps"):
            np.testing.assert_array_equal(getattr(again, name), getattr(written, name))
    assert again.sd_common_mps == 0.1 / 30


def test_what_makes_no_prior_is_a_profile_all_the_same(tmp_path):
    """A plain profile ignores the column sd_common_mps."""
    profile = read(tmp_path, "depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n0,0.1,-0.2,0.5,?\n")
    np.testing.assert_array_equal(profile.sd_mps, [0.5])


HEADER = "depth_m,v_north_mps,u_east_mps\n"
PRIOR = "depth_m,v_north_mps,u_east_mps,sd_mps,sd_common_mps\n"


@pytest.mark.parametrize(
    ("reader", "content", "words"),
    [
        (read_prior, GOOD, ["line 1", "missing column sd_mps", "a prior needs it"]),
        (read_prior, PRIOR + "0,0,0,0.1,0.05\n1,0,0,0.1,0.04\n", ["line 3 sd_common_mps = 0.04", "0.05 m/s"]),
        (read_prior, PRIOR + "0,0,0,0.1,0.05\n1,0,0,0.04,0.05\n", ["line 3 sd_common_mps = 0.05", "<= sd_mps = 0.04"]),
        (read_prior, PRIOR + "0,0,0,11,0\n", ["line 2 sd_mps = 11", "<= 10 m/s"]),
        (read_prior, PRIOR + "0,0,0,0.1,-1\n", ["line 2 sd_common_mps = -1", ">= 0"]),
        (read_profile, HEADER + "0,0,0\n10,0,0\n5,0,0\n", ["line 4", "depth_m", "5", "10 m"]),
        (read_profile, HEADER + "0,0,0\n10,0,0\n10,0,0\n", ["line 4", "depth_m", "10"]),
        (read_profile, "0,0.1,0.2\n1,0.1,0.2\n", ["line 1", "depth_m"]),
        (read_profile, "depth_m,depth_m,v_north_mps,u_east_mps\n0,0,0,0\n", ["line 1", "depth_m", "more than once"]),
        (read_profile, HEADER + "0,1_0,0\n", ["line 2", "v_north_mps", "1_0", "number"]),
        (read_profile, HEADER + "0,,0\n", ["line 2", "v_north_mps", "number"]),
        (read_profile, HEADER + "0,0,nan\n", ["line 2", "u_east_mps", "nan", "finite"]),
        (read_profile, HEADER + "-1,0,0\n", ["line 2", "depth_m", "-1", ">= 0"]),
        (read_profile, HEADER + "0,0,0\n1,5.1,0\n", ["line 3", "v_north_mps", "5.1", "5 m/s"]),
        (read_profile, HEADER + "# a comment\n0,0\n", ["line 3", "u_east_mps", "missing: column 3"]),
        (read_profile, HEADER, ["no row"]),
        (read_profile, HEADER + "0,0,0\n1,nan,nan\n2,0,0\n", ["line 3 v_north_mps", "finite"]),
        (read_profile, HEADER + '"1",0.5,0.11,0.02\n', ["line 2", "4 cells", "names 3 columns", "row.names = FALSE"]),
        (read_profile, HEADER.replace(",", ";") + "1;0,5;0,11;0,02\n", ["line 2", "4 cells", "row.names = FALSE"]),
        (read_profile, HEADER + "0,0,0,10,-0,05\n", ["line 2", "6 cells", "decimal commas", "semicolons"]),
        (read_profile, HEADER + "0;0;0\n", ["line 2 depth_m", "0;0;0", "number"]),
        (read_profile, HEADER + "0,5;0,11;0,02\n", ["line 2", "4 cells", "names separated by semicolons"]),
        (read_profile, "depth_m;v_north_mps;u_east_mps\n0;0;0\n1.000;0;0,5\n", ["line 3", "1.000", "or thousands"]),
        (read_profile, "depth_m\tv_north_mps\tu_east_mps\n1,000\t0\t0.5\n", ["line 2", "1,000", "as 1.0000"]),
        (read_profile, HEADER.replace(",", "|"), ["line 1", "separated by commas, semicolons or tabs"]),
        (read_profile, HEADER + "0," + "1" * 100_001, ["line 2", "100003 characters", "at most 100000"]),
    ],
)
def test_a_wrong_table_is_refused_with_file_line_field_value_and_bound(tmp_path, reader, content, words):
    (tmp_path / "currents.csv").write_text(content)
    with pytest.raises(ConfigError) as refused:
        reader(tmp_path / "currents.csv")
    text = str(refused.value)
    assert "\n" not in text
    for word in ["currents.csv", *words]:
        assert word in text, text
