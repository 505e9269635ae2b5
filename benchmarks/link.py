"""Closed loop over a long link with real loss: ``python -m benchmarks.link``, or ``make link``.

Two network namespaces are two hosts: plant, sensors, estimator and router in one, the controller in the other. Between
them are two TUN devices and this program, which carries every IP packet from one to the other after delay +- jitter, in
order, and loses each with the given probability; what then stalls and comes again is the kernel's TCP. The same descent
is run with the controller on the near side as well. Needs root, /dev/net/tun and ``ip``, and says which it lacks.
"""

from __future__ import annotations

import argparse
import fcntl
import heapq
import os
import random
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from services.run.run_config import Override, resolve
from services.run.summary import summarise_recording
from sim.evaluation.summary import Summary

CLI = [sys.executable, "-P", "-m", "services.cli"]
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
NEAR, FAR = f"ltv-near-{os.getpid()}", f"ltv-far-{os.getpid()}"
NEAR_IP, FAR_IP = "10.77.0.1", "10.77.0.2"
ENDPOINT = f"tcp/{NEAR_IP}:7447"
PACKET_BYTES = 65_536
PATIENCE_S = 600.0


def missing() -> str:
    """Why it cannot be done here; empty where it can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if not Path("/dev/net/tun").exists():
        return "there is no /dev/net/tun"
    if shutil.which("ip") is None:
        return "the program ip (iproute2) is not installed"
    tried = subprocess.run(["ip", "netns", "add", NEAR], capture_output=True, text=True, check=False)
    if tried.returncode != 0:
        return f"no network namespace: {tried.stderr.strip()}"
    subprocess.run(["ip", "netns", "delete", NEAR], check=True)
    return ""


class Relay(threading.Thread):
    """Carries packets between two TUN devices until ``close``. ``counts`` are of packets, carried and lost."""

    def __init__(self, near: int, far: int, *, delay_s: float, jitter_s: float, loss: float, seed: int) -> None:
        super().__init__(name="relay", daemon=True)
        self._to = {near: far, far: near}
        self._delay_s, self._jitter_s, self._loss = delay_s, jitter_s, loss
        self._rng = random.Random(seed)
        self._closed = threading.Event()
        self.carried = self.lost = 0

    def run(self) -> None:
        """Until closed."""
        free_s = dict.fromkeys(self._to, 0.0)
        on_its_way: list[tuple[float, int, int, bytes]] = []
        number = 0
        while not self._closed.is_set():
            now_s = time.monotonic()
            while on_its_way and on_its_way[0][0] <= now_s:
                _, _, into, packet = heapq.heappop(on_its_way)
                os.write(into, packet)
            wait_s = min(0.1, on_its_way[0][0] - now_s) if on_its_way else 0.1
            for device in select.select(list(self._to), [], [], wait_s)[0]:
                packet = os.read(device, PACKET_BYTES)
                if self._rng.random() < self._loss:
                    self.lost += 1
                    continue
                taken_s = self._delay_s + self._rng.uniform(-self._jitter_s, self._jitter_s)
                free_s[device] = max(free_s[device], time.monotonic() + taken_s)
                heapq.heappush(on_its_way, (free_s[device], number, self._to[device], packet))
                number += 1
                self.carried += 1

    def close(self) -> None:
        """Stop carrying."""
        self._closed.set()
        self.join()


def tun(name: str) -> int:
    """Create a TUN device of this name; the descriptor stays valid if the device moves to another namespace."""
    descriptor = os.open("/dev/net/tun", os.O_RDWR)
    fcntl.ioctl(descriptor, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TUN | IFF_NO_PI))
    return descriptor


def ip(*words: str) -> None:
    """Run ``ip`` with these arguments."""
    subprocess.run(["ip", *words], check=True)


def connect(namespace: str, device: str, own: str, other: str) -> None:
    """Put a device into a namespace of its own as the way to the other side."""
    ip("netns", "add", namespace)
    ip("link", "set", device, "netns", namespace)
    ip("-n", namespace, "link", "set", "lo", "up")
    ip("-n", namespace, "address", "add", own, "peer", other, "dev", device)
    ip("-n", namespace, "link", "set", device, "up")


def descent(folder: Path, *, controller_in: str, duration_s: float, speed: float, seed: int) -> Summary:
    """One run in the near namespace, but for the controller."""
    settings = [f"run.duration_s={duration_s}", f"run.speed={speed}", f"run.seed={seed}"]
    run_config = resolve("descent", [Override("link", settings)])
    folder.mkdir()
    scenario = folder / "scenario.toml"
    scenario.write_text(f'title = "link"\n[run]\nduration_s = {duration_s}\nspeed = {speed}\nseed = {seed}\n')
    connected = ["--connect", ENDPOINT]
    commands = {
        "router": ["router", "--listen", ENDPOINT],
        "recorder": ["recorder", str(scenario), "--out", str(folder / "run"), *connected],
        "sensors": ["sensors", str(scenario), *connected],
        "estimator": ["estimator", *connected],
        "controller": ["controller", *connected],
        "plant": ["plant", str(scenario), "--expect", "recorder", *connected],
    }
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name, words in commands.items():
            inside = ["ip", "netns", "exec", controller_in if name == "controller" else NEAR]
            with (folder / f"{name}.log").open("wb") as log:
                processes[name] = subprocess.Popen([*inside, *CLI, *words], stdin=subprocess.DEVNULL, stderr=log)
        if processes["plant"].wait(PATIENCE_S) != 0:
            sys.exit((folder / "plant.log").read_text())
        for name in ("sensors", "estimator", "controller", "recorder", "router"):
            processes[name].send_signal(signal.SIGTERM)
            processes[name].wait(30)
    finally:
        for process in processes.values():
            if process.poll() is None:
                process.kill()
            process.wait()
    return summarise_recording(run_config, folder / "run" / "run.mcap")[0]


def row(name: str, summary: Summary) -> str:
    """One line of the table."""
    delay = summary.end_to_end_delay_wall_s
    errors = f"{summary.true_error_m.mean:9.3f} {summary.tracking_error_m.mean:9.3f}"
    return f"{name:<10} {errors} {delay.median:9.3f} {delay.p99:9.3f} {summary.deadline_misses:6d}"


def main() -> None:
    """Both runs, a line each, and the ratio of their mean errors."""
    parser = argparse.ArgumentParser(description="The controller behind a long link with real loss.")
    parser.add_argument("--delay-ms", type=float, default=50.0)
    parser.add_argument("--jitter-ms", type=float, default=20.0)
    parser.add_argument("--loss", type=float, default=0.05)
    parser.add_argument("--duration-s", type=float, default=100.0)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if reason := missing():
        print(f"skipped: {reason}")
        return
    near, far = tun("ltv-near"), tun("ltv-far")
    relay = Relay(
        near,
        far,
        delay_s=options.delay_ms / 1e3,
        jitter_s=options.jitter_ms / 1e3,
        loss=options.loss,
        seed=options.seed,
    )
    try:
        connect(NEAR, "ltv-near", NEAR_IP, FAR_IP)
        connect(FAR, "ltv-far", FAR_IP, NEAR_IP)
        relay.start()
        how = {"duration_s": options.duration_s, "speed": options.speed, "seed": options.seed}
        with tempfile.TemporaryDirectory() as scratch:
            perfect = descent(Path(scratch) / "perfect", controller_in=NEAR, **how)
            long = descent(Path(scratch) / "long", controller_in=FAR, **how)
    finally:
        if relay.is_alive():
            relay.close()
        for namespace in (NEAR, FAR):
            subprocess.run(["ip", "netns", "delete", namespace], capture_output=True, check=False)
        os.close(near)
        os.close(far)
    packets = relay.carried + relay.lost
    print(f"link: {options.delay_ms:g} +- {options.jitter_ms:g} ms, {relay.lost} of {packets} packets lost")
    print("           true m    tracking  delay s   p99 s     late")
    print(row("perfect", perfect))
    print(row("link", long))
    if long.true_error_m.mean and perfect.true_error_m.mean:
        print(f"mean error over the link: {long.true_error_m.mean / perfect.true_error_m.mean:.2f} times")


if __name__ == "__main__":
    main()
