"""The examples in Python: a vehicle comes to its point once armed, and an obstacle is known to the controller."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import deque
from itertools import takewhile
from pathlib import Path
from typing import Any

import pytest

from ltv_mpc.messages import FenceInForce, Obstacle
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.session import open_session
from services.bus.topics import BY_TYPE, expression
from services.bus.wire import decode
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from tests.docs.page_reader import printed_lines, take_shown
from tests.docs.pages import blocks
from tests.system.alone import CLI, arm, controller, started

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "python"
EXAMPLE, OBSTACLE = FOLDER / "publisher.py", FOLDER / "publish_obstacles.py"


@pytest.mark.parametrize("example", [EXAMPLE, OBSTACLE])
def test_it_needs_zenoh_and_msgpack_alone(example: Path) -> None:
    imported = {
        alias.name
        for node in ast.walk(ast.parse(example.read_text()))
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    assert imported - set(sys.stdlib_module_names) == {"msgpack", "zenoh"}


@pytest.mark.parametrize("example", [EXAMPLE, OBSTACLE])
def test_without_a_router_it_ends_with_one_line(example: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{loopback.free_port()}"
    ended = subprocess.run(
        [sys.executable, "-P", str(example), endpoint], capture_output=True, text=True, check=False, timeout=60
    )
    assert ended.returncode == 1
    assert ended.stderr == f"{example.name}: no router answers at {endpoint}: start one with `ltv-mpc router`\n"


def functions_of(example: Path) -> dict[str, Any]:
    """Return the functions and constants of a program, without running it."""
    tree = ast.parse(example.read_text())
    tree.body = [
        part
        for part in tree.body
        if isinstance(part, ast.FunctionDef) or (isinstance(part, ast.Assign) and "PERIOD_S" in ast.unparse(part))
    ]
    names: dict[str, Any] = {}
    exec(compile(tree, str(example), "exec"), names)
    return names


@pytest.mark.parametrize("delay_s", [0.0, 0.1, 2.0, 4.0])
def test_the_plan_in_force_stays_until_the_next_one_begins_whatever_the_delay(delay_s: float) -> None:
    """Plan number i asks for i N; every third plan begins before the one that was sent before it."""
    example = functions_of(EXAMPLE)
    plans: list[dict[str, Any]] = []
    followed: list[float] = []
    wanted: list[float] = []
    sent: list[tuple[int, float]] = []
    for i in range(100):
        now = i * 300_000_000
        start = now + round(delay_s * 1e9) - (400_000_000 if delay_s and i % 3 == 2 else 0)
        plan = {"t_ns": [start, start + 10_000_000_000], "thrust_N": [[float(i)] * 3] * 2}
        sent = [old for old in sent if old[0] < start] + [(start, float(i))]
        plans = example["follow"](plans, plan, now)
        followed.append(example["target"](plans, now)[0])
        wanted.append(max((old for old in sent if old[0] <= now), default=(0, 0.0))[1])
    assert followed == wanted
    assert followed[-1] > 80.0
    assert len(plans) <= delay_s / 0.3 + 2


@pytest.mark.timeout(400)
def test_it_comes_to_its_point_once_armed_and_the_obstacle_is_known_to_the_controller(tmp_path: Path) -> None:
    (tmp_path / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    fences, reports = Mailbox(), dict[int, Obstacle]()

    def has_come(line: str) -> bool:
        found = re.match(r"(-?[\d.]+) m north, (-?[\d.]+) m east, controller", line)
        return found is not None and abs(float(found[1])) < 0.3 and abs(float(found[2])) < 0.3

    with (
        controller(loopback.free_port(), ("--reference", str(tmp_path / "point.toml"))) as (endpoint, _),
        open_session(BusOptions(connect=(endpoint,)), stop=StopRequest(), say=print) as bus,
        started(sys.executable, "-P", str(OBSTACLE), endpoint) as (_, obstacle),
        started(sys.executable, "-P", str(EXAMPLE), endpoint) as (_, vehicle),
    ):
        bus.subscribe(expression(BY_TYPE[FenceInForce]), BY_TYPE[FenceInForce], fences)
        assert "3.00 m north" in vehicle.until(lambda line: "disarmed" in line)  # nothing moves before
        output = arm(CLI, endpoint)
        vehicle.until(has_come, within_s=180.0)
        printed = deque(printed_lines(output + "".join(vehicle.said), exact=False))
        assert obstacle.until(lambda line: "east" in line) == "40.0 m north, -30.0 m east\n"
        obstacle.until(lambda line: "-26.0 m east" in line or "-25.9 m east" in line)  # at 0.4 m/s, after 10 s
        while len(reports) < 2:
            frame = fences.take(60.0)
            assert frame is not None, reports
            reports |= {report.t_ns: report for report in decode(FenceInForce, frame.payload)[0].obstacles}
    assert [take_shown(text, printed) for text in shown_by_the_tutorial()] == [None, None]
    assert {report.id for report in reports.values()} == {257123456}
    first, second, *_ = sorted(reports)
    assert reports[first].velocity_east_mps == pytest.approx(0.4)
    assert reports[first].covariance_m2 == (9.0, 0.0, 9.0)
    assert second - first >= 10e9


def shown_by_the_tutorial() -> list[str]:
    """Return the outputs that the tutorial shows below the commands of its terminals: of `arm` and of the publisher."""
    page = blocks("docs/tutorial.md")
    terminals = next(i for i, block in enumerate(page) if "examples/python/publisher.py" in block.text)
    return [block.text for block in takewhile(lambda block: block.language == "text", page[terminals + 1 :])]
