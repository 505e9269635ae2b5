"""The controller on another host than the vehicle: what a long and lossy link between them costs.

A perfect link has no delay at all: lock step. Processes on one host would have the same error within some per cent, and
take as long again.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from services.run.run_config import Override, RunConfig, resolve
from services.run.summary import summarise_recording
from services.supervisor import loopback
from services.tools import lockstep_run
from sim.evaluation.summary import Summary

CLI = [sys.executable, "-P", "-m", "services.cli"]
PROXY = Path(__file__).with_name("delaying_proxy.py")
PATIENCE_S = 150.0
SETTINGS = ("run.duration_s=35", "run.speed=1")


def over_the_link(run_config: RunConfig, folder: Path) -> Summary:
    """Run a descent with plant, sensors and estimator on one side of the link, the controller on the other."""
    scenario = folder / "scenario.toml"
    scenario.write_text('title = "link"\n[run]\nduration_s = 35.0\nspeed = 1.0\n')
    near, far = loopback.free_port(), loopback.free_port()
    here = ["--connect", f"tcp/127.0.0.1:{near}"]
    there = ["--connect", f"tcp/127.0.0.1:{far}"]
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
    summary, _ = summarise_recording(run_config, folder / "run" / "run.mcap")
    return summary


def test_the_mean_error_over_a_lossy_link_is_at_most_1_3_times_a_perfect_ones(tmp_path: Path) -> None:
    run_config = resolve("descent", [Override("test", SETTINGS)])
    long = over_the_link(run_config, tmp_path)
    assert long.duration_s >= 34.9
    assert long.end_to_end_delay_s.median is not None
    assert long.end_to_end_delay_s.median > 0.1  # there and back, in vehicle time: the link was in between
    ours, perfect = long.true_error_m.mean, lockstep_run.run(run_config).true_error_m.mean
    assert ours is not None
    assert perfect is not None
    assert ours <= 1.3 * perfect, f"{ours:.3f} m over the link, {perfect:.3f} m without"
