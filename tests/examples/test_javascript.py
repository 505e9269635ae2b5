"""The messages are independent of Python: JavaScript reads each of them and writes an estimate, by the schemas."""

from __future__ import annotations

import math
import shutil
import subprocess
import time
from pathlib import Path

import msgpack
import pytest

from ltv_mpc.messages import Estimate, Plan
from services.bus.topics import TOPICS
from services.bus.wire import decode, encode
from tests.services.bus.messages import EXAMPLES, HEADER

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "javascript"
PATIENCE_S = 120.0


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the example with its packages in a temporary folder: nothing is installed into the repository."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("no node and npm on this machine: what JavaScript makes of the payload is not tested here")
    folder = tmp_path_factory.mktemp("javascript")
    for name in ("package.json", "package-lock.json", "decode.mjs"):
        shutil.copy(EXAMPLE / name, folder)
    command = [npm, "ci", "--no-audit", "--no-fund", "--ignore-scripts"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip(f"no answer of npm's registry within {PATIENCE_S:g} s: @msgpack/msgpack is not here")
    if done.returncode:
        pytest.skip(f"npm cannot install @msgpack/msgpack: {done.stderr.strip().splitlines()[-1:]}")
    return folder / "decode.mjs"


def run(program: Path, frames: list[tuple[str, bytes]], estimate: Path) -> subprocess.CompletedProcess[str]:
    recorded = program.parent / "frames"
    packed = (msgpack.packb({"signal": signal, "payload": payload}) for signal, payload in frames)
    recorded.write_bytes(b"".join(packed))
    command = ["node", str(program), str(recorded), str(ROOT / "docs" / "schemas"), str(estimate)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


def test_it_reads_every_message_as_its_schema_says(program: Path, tmp_path: Path) -> None:
    frames = [(type(signal).__name__, encode(signal, HEADER)) for signal in EXAMPLES]
    assert {signal for signal, _ in frames} == {topic.message_type.__name__ for topic in TOPICS}
    done = run(program, frames, tmp_path / "estimate")
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == [signal for signal, _ in frames]
    assert all(line.endswith("as its schema says") for line in lines)


def test_it_sees_what_is_not_as_the_schema_says(program: Path, tmp_path: Path) -> None:
    plan = next(signal for signal in EXAMPLES if isinstance(signal, Plan))
    message = msgpack.unpackb(encode(plan, HEADER))
    wrong = ({"t_ns": [0.5]}, {"origin": "guessed"}, {"cycle_t_ns": None}, {"thrust_kN": 1.0}, {"epoch": 2**48})
    frames = [("Plan", msgpack.packb(message | change)) for change in wrong]
    frames.append(("Plan", msgpack.packb({name: value for name, value in message.items() if name != "states"})))
    done = run(program, frames, tmp_path / "estimate")
    assert done.returncode == 1
    says = ("Plan.t_ns[0]", "Plan.origin", "Plan.cycle_t_ns", "thrust_kN is unknown", "epoch", "Plan.states is missing")
    for line, problem in zip(done.stdout.splitlines(), says, strict=True):
        assert problem in line


def test_what_it_writes_is_an_estimate_to_the_decoder_with_nanoseconds_since_1970(program, tmp_path) -> None:
    before = time.time_ns()
    assert run(program, [], tmp_path / "estimate").returncode == 0
    estimate, header = decode(Estimate, (tmp_path / "estimate").read_bytes())
    assert before - 1_000_000 <= estimate.t_ns <= time.time_ns()
    assert (estimate.north_m, estimate.east_m, estimate.depth_m) == (1.5, -2.0, 12.25)
    assert estimate.heading_rad == math.pi / 2
    assert (estimate.current, estimate.covariance, header.sequence) == (None, None, 0)
