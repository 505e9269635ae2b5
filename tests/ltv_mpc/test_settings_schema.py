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
    ("names", "slips"),
    [
        (
            NAMES,
            "dmeo=demo decent=descent HOVER=hover simulate=sim dashbrod=dashboard low_yaw=low-yaw help= run= foo= x= =",
        ),
        (NAMES, "bluerobot=bluerobotics-boat smi=sim localize=localise"),
        (OPTIONS, "--sed=--seed -speed=--speed --Out=--out --horzon=--horizon-s --delay=--compute-delay-s --bogus="),
        (OPTIONS, "--no-dashbord=--no-dashboard --out-dir=--out --quiet="),
        (KEYS, "seed=run.seed duration=run.duration_s delay=run.compute_delay_s water.std=water.sd_mps boat.paint="),
        (
            KEYS,
            "wather.sd=water.sd_mps weights.thrst=controller.weights.thrust controller.hoirzon=controller.horizon_s",
        ),
        (TOPICS, "imu=sensor/imu world/truht=world/truth plann=plan"),
    ],
)
def test_a_slip_in_a_name_is_recognised(names: tuple[str, ...], slips: str) -> None:
    """Each slip stands before the name that is meant."""
    for wrong, meant in (slip.split("=") for slip in slips.split()):
        assert closest_name(wrong, names) == (meant or None), wrong
