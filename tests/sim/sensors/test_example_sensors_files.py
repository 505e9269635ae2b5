"""The sensors files under examples/: each can be read and measures; a base must be a shipped file."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest

from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import AdcpPing, BottomTrack, LblRange, UsblFix
from sim.scenario import Scenario, with_overrides
from tests.sim.worlds import MS, S, sensed, truth

EXAMPLES = Path(__file__).parents[3] / "examples" / "sensors"
REALISTIC, BASE = SensorConfig.load("realistic"), '"realistic"'


def load(name: str) -> SensorConfig:
    return SensorConfig.load(str(EXAMPLES / f"{name}.toml"))


@pytest.mark.parametrize("name", ["bottom_track", "lbl", "usbl"])
def test_an_example_of_one_more_sensor_is_the_realistic_suite_and_that_table(name):
    suite = load(name)
    assert suite.name == name
    assert getattr(suite, name) is not None
    back = msgspec.structs.replace(suite, **{name: None}, name="realistic", description=REALISTIC.description)
    assert back == REALISTIC


def test_the_example_of_an_own_profiler_differs_only_in_its_keys():
    suite = load("own_adcp")
    own = {
        "mounting_rad": (0.0, 0.0, pytest.approx(math.radians(45.0))),
        "mounting_known_to_rad": pytest.approx(math.radians(0.1)),
        "lever_arm_m": (-0.6, 0.15, 0.4),
        "latency_ns": 200_000_000,
    }
    for field in REALISTIC.adcp.__struct_fields__:
        assert getattr(suite.adcp, field) == own.get(field, getattr(REALISTIC.adcp, field)), field
    assert (suite.imu, suite.compass, suite.tdcp) == (REALISTIC.imu, REALISTIC.compass, REALISTIC.tdcp)


@pytest.mark.parametrize(
    ("name", "kind", "late_ns"),
    [
        ("bottom_track", BottomTrack, 0),
        ("lbl", LblRange, 110_000_000),
        ("usbl", UsblFix, 800_000_000),
        ("own_adcp", AdcpPing, 200_000_000),
        ("600_khz", AdcpPing, 0),
    ],
)
def test_each_example_measures_in_a_hover_at_20_m(name, kind, late_ns):
    scenario = with_overrides(Scenario.load("hover"), ["water.bottom_m=35"])
    world = [truth(t, position_m=(0.0, 0.0, 20.0)) for t in range(-S, 12 * S, 50 * MS)]
    late = [t - message.t_ns for t, message in sensed(load(name), world, scenario) if isinstance(message, kind)]
    assert len(late) >= 4
    # LBL: half of 0.21 s after the middle, but for outliers
    assert late_ns - 20 * MS <= min(late) <= max(late) < late_ns + 70 * MS


@pytest.mark.parametrize(
    ("base", "text", "says"),
    [
        ('"realistc"', "", 'own.toml: base = "realistc": no shipped name; shipped: paper, realistic; did you mean'),
        ('"./mine.toml"', "", 'own.toml: base = "./mine.toml": must be the name of a shipped sensors file'),
        (BASE, "[usbl]\nperiod_ns = 2_000_000_000", 'key "latency_ns" in [usbl] is missing'),
        (BASE, "[adcp]\nlatency_ns = 2_000_000_000", "[adcp] latency_ns = 2000000000: must be >= 0 and <= 1000000000"),
    ],
)
def test_a_base_must_be_a_shipped_file_and_keys_that_replace_its_own_are_validated(tmp_path, base, text, says):
    (tmp_path / "own.toml").write_text(f'base = {base}\nname = "own"\n{text}\n')
    with pytest.raises(ConfigError) as error:
        SensorConfig.load(str(tmp_path / "own.toml"))
    assert says in str(error.value)
