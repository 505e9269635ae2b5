"""The controller on another host than the vehicle: what a long and lossy link between them costs."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from services.launch import loopback
from services.run.situation import Override, resolve
from services.run.summary import of_recording

CLI = [sys.executable, "-P", "-m", "services.cli"]
PROXY = Path(__file__).with_name("delaying_proxy.py")
PATIENCE_S = 150.0
SETTINGS = ("run.duration_s=35", "run.speed=1")


def mean_error_m(folder: Path, *, through_the_link: bool) -> float:
    """Of a descent: plant, sensors and estimator on one side, the controller behind the link or not."""
    situation = resolve("descent", [Override("test", SETTINGS)])
    folder.mkdir()
    scenario = folder / "scenario.toml"
    scenario.write_text('title = "link"\n[run]\nduration_s = 35.0\nspeed = 1.0\n')
    near, far = loopback.free_port(), loopback.free_port()
    here = ["--connect", f"tcp/127.0.0.1:{near}"]
    there = ["--connect", f"tcp/127.0.0.1:{far}"] if through_the_link else here
    commands = {
        "router": [*CLI, "router", "--listen", f"tcp/127.0.0.1:{near}"],
        "proxy": [sys.executable, str(PROXY), str(far), str(near)],
        "recorder": [*CLI, "recorder", str(scenario), "--out", str(folder / "run"), *here],
        "sensors": [*CLI, "sensors", str(scenario), *here],
        "estimator": [*CLI, "estimator", *here],
        "controller": [*CLI, "controller", *there],
        "plant": [*CLI, "plant", str(scenario), "--expect", "recorder", *here],
    }
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name, command in commands.items():
            with (folder / f"{name}.log").open("wb") as log:
                processes[name] = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        assert processes["plant"].wait(PATIENCE_S) == 0, (folder / "plant.log").read_text()
        for name in ("sensors", "estimator", "controller", "recorder", "router"):
            processes[name].send_signal(signal.SIGTERM)
            assert processes[name].wait(PATIENCE_S) == 0, (folder / f"{name}.log").read_text()
    finally:
        for process in processes.values():
            if process.poll() is None:
                process.kill()
            process.wait()
    summary, _ = of_recording(situation, folder / "run" / "run.mcap")
    assert summary.duration_s >= 34.9
    return summary.true_error_m.mean


def test_the_mean_error_over_a_long_lossy_link_is_at_most_1_3_times_that_of_a_perfect_one(tmp_path: Path) -> None:
    perfect = mean_error_m(tmp_path / "perfect", through_the_link=False)
    long = mean_error_m(tmp_path / "long", through_the_link=True)
    assert long <= 1.3 * perfect, f"{long:.3f} m over the link, {perfect:.3f} m without"
