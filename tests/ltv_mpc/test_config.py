"""Settings files: an error names file, field, value and bound in one line, and no other exception escapes."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc import config
from ltv_mpc.config import missing_file_hint
from ltv_mpc.control.config import ControllerConfig, WeightSettings
from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.references import Point, Reference
from ltv_mpc.vehicle.parameters import Vehicle

PAPER = (Path(config.__file__).parent / "vehicle" / "files" / "paper.toml").read_text()


def paper(before: str, after: str) -> str:
    """Return the paper's vehicle file with one other line."""
    return PAPER.replace(before, after, 1)


def refusal(text: str, kind: Any) -> str:
    with pytest.raises(ConfigError) as error:
        config.parse(tomllib.loads(text), kind, source="settings x.toml")
    assert str(error.value).isprintable()
    return str(error.value)


@pytest.mark.parametrize(
    ("kind", "text", "says"),
    [
        (ControllerConfig, "horizon_s = -5", "horizon_s = -5: must be >= 0.3 and <= 120"),
        (ControllerConfig, "horizon_s = nan", "horizon_s = nan: must be finite"),
        (ControllerConfig, 'horizon_s = "5"', 'horizon_s = "5": must be a number >= 0.3 and <= 120'),
        (ControllerConfig, "horizon_s = true", "horizon_s = true: must be a number >= 0.3 and <= 120"),
        (ControllerConfig, "max_iterations = 1.5", "max_iterations = 1.5: must be an integer >= 1 and <= 100000"),
        (ControllerConfig, "lateral = 1", "lateral = 1: must be true or false"),
        (ControllerConfig, "horizon = 5", 'unknown key "horizon"; did you mean "horizon_s"?'),
        (ControllerConfig, '"a\\nb" = 5', 'unknown key "a\\nb"; known: horizon_s,'),
        (ControllerConfig, "[weights]\nthrst = 1", 'unknown key "thrst" in [weights]; did you mean "thrust"?'),
        (ControllerConfig, "[weights]\nthrust = -1", "[weights] thrust = -1: must be >= 0 and <= 1000000"),
        (ControllerConfig, "weights = 3", "weights = 3: must be a table with position_per_m2,"),
        (Vehicle, paper("arm_m = 0.2", ""), 'key "arm_m" in [thruster.port] is missing: must be a number >= 0'),
        (Vehicle, paper("min_N = -62.5", "min_N = 62.5"), "[thruster.port] min_N = 62.5: must be >= -1000000"),
        (Vehicle, paper("[yaw]", "[yow]"), 'unknown key "yow"; did you mean "yaw"?'),
        (
            Vehicle,
            paper("[thruster.port]", "[thruster.port]\npwm_us = 3"),
            "[thruster.port] pwm_us = 3: must be a list",
        ),
        (Reference, "", 'key "kind" is missing: must be "point" or "hold" or "line" or'),
        (Reference, 'kind = "holt"', 'kind = "holt": must be "point" or "hold" or "line" or'),
        (Reference, 'kind = "hold"\ndepth_m = -1', "depth_m = -1: must be >= 0 and <= 11000"),
        (Reference, 'kind = "point"\nnorth_m = 1', "a position needs north_m and east_m, or latitude_deg and"),
        (Reference, 'kind = "hold"\nnorth_m = 1', 'unknown key "north_m"; known: kind, start_s,'),
    ],
)
def test_a_refusal_names_file_field_value_and_bound(kind: Any, text: str, says: str) -> None:
    """In a union of kinds the kind that was meant counts."""
    assert refusal(text, kind).startswith(f"settings x.toml: {says}")


def test_an_integer_is_good_where_a_number_is_expected() -> None:
    assert config.parse({"horizon_s": 5}, ControllerConfig, source="x").horizon_s == 5.0


def test_a_list_of_the_wrong_length_is_refused() -> None:
    text = config.to_toml(SensorConfig.load("paper")).replace("    0.0,\n    0.0,\n    0.0,\n", "    0.0,\n")
    assert "] lever_arm_m = [0.0]: must be a list of 3, each a number" in refusal(text, SensorConfig)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (bytes(range(256)), "is not UTF-8 text (byte 128)"),
        (b"a = 1\0", "binary data, not text"),
        (b"a = ", "not valid TOML"),
        (b"a = " + b"[" * 100_000, "deep"),
        (b"a = " + b"9" * 5000, "not valid TOML"),
        (b"#" * (config.MAX_FILE_BYTES + 1), f"at most {config.MAX_FILE_BYTES}; check the file name"),
    ],
)
def test_a_file_that_is_no_settings_file_is_refused(tmp_path: Path, content: bytes, says: str) -> None:
    file = tmp_path / "x.toml"
    file.write_bytes(content)
    with pytest.raises(ConfigError, match=r"x\.toml") as error:
        ControllerConfig.load(str(file))
    assert says in str(error.value)
    assert str(error.value).isprintable()


def test_a_key_of_thousands_of_parts_is_refused_unread(tmp_path: Path) -> None:
    """The time of tomllib grows with the square of their number: half a minute for 64 kB."""
    for text in ("a" + ".a" * 32_000 + " = 1", "[a" + " . 'a'" * 10_000 + "]", '"b".' * 100_000):
        with pytest.raises(RecursionError):
            config.loads(text)
    path = tmp_path / "x.toml"
    path.write_text("a" + ".a" * 400_000 + " = 1")
    with pytest.raises(ConfigError, match="at most 10 deep"):
        config.read_toml(path, what="settings")
    assert config.loads("a" + ".a" * 9 + " = 1 # 1.5, e.g. so") == tomllib.loads("a" + ".a" * 9 + " = 1")


def test_a_bare_name_is_a_shipped_one_and_an_unknown_one_lists_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "paper").write_text("not this one")
    (tmp_path / "otter").write_text(PAPER)
    assert Vehicle.load("paper").name == "paper"
    with pytest.raises(
        ConfigError, match=r'vehicle "papr": no shipped name; shipped: .*paper.*; did you mean "paper"\?'
    ):
        Vehicle.load("papr")
    with pytest.raises(ConfigError, match=r"for the file here write \./otter"):
        Vehicle.load("otter")
    assert Vehicle.load("./otter").name == "paper"


def test_what_is_written_is_read_back_bit_for_bit() -> None:
    settings_ = ControllerConfig(horizon_s=0.1 + 0.2, weights=WeightSettings(thrust=1e-300), max_iterations=7)
    assert config.parse(tomllib.loads(config.to_toml(settings_)), ControllerConfig, source="x") == settings_
    point = Point(north_m=1.0, east_m=2.0)
    assert config.parse(tomllib.loads(config.to_toml(point)), Reference, source="x") == point  # None is left out


def test_a_missing_file_error_names_the_similar_file_or_the_missing_folder(tmp_path: Path) -> None:
    (tmp_path / "hull.toml").write_text("x = 1\n")
    (tmp_path / "other.toml").write_text("x = 1\n")
    for name, said in (
        ("hul.toml", f"no such file; did you mean {tmp_path / 'hull.toml'}?"),
        ("something_else.toml", "no such file: name an existing file"),
        ("nowhere/hull.toml", f"no such file: there is no folder {tmp_path / 'nowhere'}"),
    ):
        assert missing_file_hint(tmp_path / name) == said
