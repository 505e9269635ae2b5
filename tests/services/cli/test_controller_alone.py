"""``ltv-mpc controller``: its options and its output before the first message."""

from __future__ import annotations

import socket
from pathlib import Path

import msgspec
import pytest

from ltv_mpc import ControllerConfig, Vehicle
from ltv_mpc.control.resolution import settled
from services.bus.options import BusOptions
from services.cli.app import run
from services.processes import controller

SETTLED = settled(ControllerConfig(), Vehicle.load("paper"))


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[controller.Config]:
    calls: list[controller.Config] = []

    def main(config: controller.Config) -> int:
        calls.append(config)
        return 0

    monkeypatch.setattr(controller, "main", main)
    return calls


def test_rate_and_horizon_are_those_of_the_options_and_the_rest_of_the_file(tmp_path, started) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text("horizon_s = 3.0\nmax_iterations = 77\n")
    words = f"controller --settings {settings} --rate-hz 5 --metrics 9464 --input-delay-s 0.05".split()
    assert run(words) == 0
    assert run([*words, "--horizon-s", "6"]) == 0
    first, second = (config.resolved() for config in started)
    assert (first.period_ns, first.horizon_s, first.max_iterations) == (200_000_000, 3.0, 77)
    assert (second.period_ns, second.horizon_s, second.max_iterations) == (200_000_000, 6.0, 77)
    assert (started[0].metrics, started[0].input_delay_s) == (9464, 0.05)


def test_without_a_horizon_it_is_the_vehicle_s_own_also_beside_a_settings_file(tmp_path, started) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text("max_iterations = 77\n")
    for name in ("paper", "low-yaw"):
        assert run(["controller", "--vehicle", name]) == 0
    assert run(["controller", "--vehicle", "low-yaw", "--settings", str(settings)]) == 0
    paper, slow, with_file = (config.resolved() for config in started)
    assert paper.horizon_s == 13.8 < slow.horizon_s
    assert (with_file.horizon_s, with_file.max_iterations) == (slow.horizon_s, 77)
    assert paper.stages == slow.stages == 34


def test_a_checkpoint_arms_only_with_an_option_and_for_a_minute(started: list[controller.Config]) -> None:
    for words in ("", "--state s", "--state s --resume-armed", "--state s --resume-armed --resume-within-s 5"):
        assert run(["controller", *words.split()]) == 0
    kept = [(config.state, config.arms_within_s) for config in started]
    folder = Path("s")
    assert kept == [(None, None), (folder, None), (folder, 60.0), (folder, 5.0)]


def test_a_port_that_is_taken_is_said_and_nothing_is_started(capsys, monkeypatch) -> None:
    monkeypatch.setattr(controller, "warm_up", lambda *_: pytest.fail("started"))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert controller.main(controller.Config(bus=BusOptions(), metrics=port)) == 1
    assert f"--metrics {port}: Address already in use" in capsys.readouterr().err


def test_it_names_every_key_in_its_namespace_with_rate_and_fields() -> None:
    lines = list(controller.announcement(BusOptions(namespace="auv/7"), msgspec.structs.replace(SETTLED, period_s=0.2)))
    told = {line.split()[1]: line for line in lines if line.startswith(("reads", "writes"))}
    keys = "estimate, applied, command, manual, heartbeat, battery, leak, obstacles, plan, fence, acknowledged, model"
    assert set(told) == {f"auv/7/{key}" for key in (*keys.split(", "), "controller/status")}
    estimate = told["auv/7/estimate"]
    assert estimate.startswith("reads")
    assert " 10 /s " in estimate
    needed, optional = estimate.split("[")
    assert needed.endswith("t_ns, north_m, east_m, heading_rad, yaw_rate_radps, velocity_north_mps, velocity_east_mps ")
    assert optional == "depth_m, velocity_down_mps, altitude_m, covariance, current]"
    assert told["auv/7/plan"].startswith("writes")
    assert " 5 /s " in told["auv/7/plan"]
    assert " on events " in told["auv/7/command"]
