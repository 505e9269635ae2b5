"""Suggestions for wrong names: commands, options, shipped files, topics and keys share one rule."""

from __future__ import annotations

import pytest

from ltv_mpc.settings_schema import closest_name

NAMES = ("demo", "descent", "hover", "sim", "report", "replay", "dashboard", "localise", "low-yaw", "bluerobotics-boat")
OPTIONS = ("--seed", "--set", "--speed", "--out", "--horizon-s", "--compute-delay-s", "--no-dashboard", "--settings")
KEYS = (
    *("run.seed", "run.speed", "run.duration_s", "run.compute_delay_s", "water.kind", "water.sd_mps"),
    *("water.feature.step_mps", "plant.mismatch.thrust", "controller.weights.thrust", "controller.horizon_s"),
)
TOPICS = ("world/truth", "sensor/imu", "estimate", "plan")


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        *(("dmeo", "demo"), ("decent", "descent"), ("HOVER", "hover"), ("smi", "sim"), ("simulate", "sim")),
        *(("reporrt", "report"), ("dashbrod", "dashboard"), ("localize", "localise"), ("low_yaw", "low-yaw")),
        *(("bluerobotic", "bluerobotics-boat"), ("bluerobot", "bluerobotics-boat")),
        *(("help", None), ("run", None), ("foo", None), ("x", None), ("", None)),
    ],
)
def test_a_slip_in_a_name_is_recognised(wrong: str, meant: str | None) -> None:
    assert closest_name(wrong, NAMES) == meant


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        *(("--sed", "--seed"), ("--speeed", "--speed"), ("-speed", "--speed"), ("--Out", "--out")),
        *(("--horizon", "--horizon-s"), ("--horzon", "--horizon-s"), ("--delay", "--compute-delay-s")),
        *(("--no-dashbord", "--no-dashboard"), ("--out-dir", "--out"), ("--bogus", None), ("--quiet", None)),
    ],
)
def test_a_slip_in_an_option_is_recognised(wrong: str, meant: str | None) -> None:
    assert closest_name(wrong, OPTIONS) == meant


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        *(
            ("seed", "run.seed"),
            ("sped", "run.speed"),
            ("duration", "run.duration_s"),
            ("delay", "run.compute_delay_s"),
        ),
        *(("water.sd", "water.sd_mps"), ("water.std", "water.sd_mps"), ("wather.sd", "water.sd_mps")),
        *(("weights.thrst", "controller.weights.thrust"), ("controller.hoirzon", "controller.horizon_s")),
        *(("xyz", None), ("boat.paint", None)),
    ],
)
def test_a_slip_in_a_key_or_a_missing_table_is_recognised(wrong: str, meant: str | None) -> None:
    assert closest_name(wrong, KEYS) == meant


@pytest.mark.parametrize(("wrong", "meant"), [("imu", "sensor/imu"), ("world/truht", "world/truth"), ("plann", "plan")])
def test_a_slip_in_a_topic_is_recognised(wrong: str, meant: str) -> None:
    assert closest_name(wrong, TOPICS) == meant
