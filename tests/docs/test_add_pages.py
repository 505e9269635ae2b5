"""The pages "How to add ...": the example of each, built from the page alone, works."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import pytest

from tests.docs.changed_tree import build, run
from tests.docs.pages import NAMES, ROOT

PROTOCOL = """
import sys
sys.path.insert(0, sys.argv[1] + "/docs/extensions")
import protocol_page
"""

OF_EACH = {
    "docs/add-sensor.md": PROTOCOL
    + """
from ltv_mpc import simulate
from services.reporting.plots.collector import NIS
from tests.ltv_mpc.localisation.sensors import test_expectations, test_registry
from tests.services.bus import test_wire

test_registry.test_each_sensor_stands_under_its_name_with_its_settings()
test_registry.test_each_sensor_has_a_topic_and_a_simulation()
test_registry.test_the_example_of_a_vehicle_at_rest_leaves_no_residual("speed_log")
test_expectations.test_partials_are_minus_the_derivatives_of_the_residual("speed_log")
test_wire.test_every_topic_has_an_example_here()
assert "speed_log" in NIS
assert "LogSpeed" in protocol_page.page()

used, error_m = [], []
for sensors in ("./with_log.toml", "realistic"):
    dive = simulate("descent", sensors=sensors, duration_s=30, seed=3)
    parts = [part for report in dive.messages["localisation"] for part in report.sensors if part.sensor == "speed_log"]
    used.append(sum(part.used for part in parts))
    error_m.append(dive.summary["localisation_error_absolute_m"]["mean"])
assert used[0] > 140 and used[1] == 0, used  # of 150 in 30 s at 5 Hz
assert error_m[0] < 1.05 * error_m[1], error_m
""",
    "docs/add-solver.md": """
import numpy as np
from msgspec.structs import replace
from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, references
from ltv_mpc.geofence.fence import Disc, Fence
from ltv_mpc.references import Place

wreck = Disc(name="wreck", centre=Place(north_m=1.5, east_m=0.1), radius_m=0.6)
fence = Fence(margin_m=0.1, keep_out_disc=(wreck,))

def plans(solver):
    point = references.Point(north_m=0.0, east_m=0.0)
    controller = Controller(Vehicle.load("paper"), point, ControllerConfig(solver=solver))
    estimate = Estimate.at_rest(north_m=-0.4, east_m=0.3, heading_rad=0.5)
    for k, zones in enumerate((None, fence, None)):
        controller.set_fence(zones)
        yield controller.plan(replace(estimate, t_ns=300_000_000 * k))

for expected, found in zip(plans("osqp"), plans("piqp-native")):
    assert found.origin == "solved" and found.solve.iterations > 1, found
    np.testing.assert_allclose(found.thrust_N, expected.thrust_N, atol=0.05)
""",
    "docs/add-cost-term.md": """
import os
os.environ["NUMBA_DISABLE_JIT"] = "1"  # to compile takes longer
from tests.ltv_mpc.control.ocp import test_terms

test_terms.test_the_model_has_value_and_slope_of_the_exact_term("yaw_rate_s2_per_rad2", 0)
test_terms.test_all_terms_are_in_cost_and_problem()
for name in test_terms.SOLVERS:
    test_terms.test_every_solver_feels_it("yaw_rate_s2_per_rad2", name)
""",
    "docs/add-vehicle.md": """
from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, references
from services.cli.app import run

file = "ltv_mpc/vehicle/files/skiff.toml"
assert run(["vehicle", "check", file]) == 0
controller = Controller(Vehicle.load(file), references.Point(north_m=5.0, east_m=0.0), ControllerConfig())
plan = controller.plan(Estimate.at_rest(depth_m=None))
assert plan.origin == "solved" and plan.thrust_N[1:, :2].sum() > 0.0
""",
    "docs/add-reference.md": """
from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, references

eight = references.load("./eight.toml")
points = eight.path().points
assert abs(points[:, 0].max() - 10.0) < 0.01 and abs(points[:, 1].max() - 5.0) < 0.01
plan = Controller(Vehicle.load("paper"), eight, ControllerConfig()).plan(Estimate.at_rest())
assert plan.origin == "solved"
assert plan.states[-1, 0] > 0.1 and plan.states[-1, 1] > 0.1  # it sets out to the north-east
""",
    "docs/add-topic.md": PROTOCOL
    + """
from ltv_mpc.messages import WaterTemperature
from services.bus import wire
from services.bus.roles import writes
from tests.services.bus import test_wire

frame = wire.encode(WaterTemperature(t_ns=1, temperature_degC=8.5), wire.Header(epoch=1, sequence=0))
assert wire.decode(WaterTemperature, frame)[0].temperature_degC == 8.5
try:
    wire.decode(WaterTemperature, frame.replace(wire.pack({"": 8.5})[2:], wire.pack({"": 85.0})[2:]))
except wire.WireError as error:
    assert "temperature_degC" in str(error)
else:
    raise AssertionError("a temperature out of bounds is accepted")
assert "temperature" in writes("thermometer")
test_wire.test_every_topic_has_an_example_here()
assert "WaterTemperature" in protocol_page.page()
""",
    "docs/edges.md": """
import json, math, random, socket
from services.bus.mailbox import Mailbox
from services.cli.app import run
from services.edges.edge import Outgoing, Received
from services.edges.json_lines import JsonEdge
from services.processes.json_lines import UdpLink
from tests.fuzz.targets import all_targets
from tests.services.edges.plans import SECOND_NS, plan

def line(**fields):
    state = {"t_ms": 7000, "heading_deg": 90.0, "north": 3.0, "east": 4.0, "speed": 2.0}
    return json.dumps(state | fields).encode()

edge = JsonEdge(epoch=1)
(estimate,) = edge.receive(Received("", line(), b"", 1_000))
assert (estimate.north_m, estimate.east_m, estimate.t_ns) == (3.0, 4.0, 7 * SECOND_NS)
assert abs(estimate.velocity_north_mps) < 1e-12 and abs(estimate.velocity_east_mps - 2.0) < 1e-12
for broken in (b"", b"[]", line(north="x"), line(north=math.nan), line(t_ms=math.inf), b"[" * 100_000):
    assert edge.receive(Received("", broken, b"", 2_000)) == []
assert (edge.accepted, edge.refused) == (1, 6)
assert list(edge.step(501_000)) == []
list(edge.take(plan(7 * SECOND_NS), 1_000))
for t_us, thrusts in ((501_000, {"port": 5.0, "starboard": -10.0}), (2_101_000, {"port": 0.0, "starboard": 0.0})):
    (frame,) = edge.step(t_us)
    assert json.loads(frame.payload) == thrusts
(target,) = (target for target in all_targets() if target.name == "json lines")
accepted = 0
for seed in range(500):
    found = target.take(target.frame(random.Random(seed)))
    if found is not None:
        target.check(found)
        accepted += 1
assert 0 < accepted < 500
mailbox, vehicle = Mailbox(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
vehicle.settimeout(60.0)
link = UdpLink(0, mailbox)
for payload in (b"", line()):
    vehicle.sendto(payload, link.socket.getsockname())
    taken = mailbox.take(60.0)
    assert taken.payload == payload
link.send(Outgoing("127.0.0.1:1", b"nobody listens"))
link.send(Outgoing(taken.key, b"thrusts"))
assert vehicle.recv(4096) == b"thrusts"
assert run(["json-lines", "--connect", "nowhere"]) == 2
run(["json-lines", "--help"])
""",
    "docs/add-command.md": """
from services.cli.app import run

assert run(["--help"]) == 0
assert run(["horizon", "paper"]) == 0
assert run(["horizon", "no-such-vehicle"]) == 2
""",
    "docs/add-metric.md": """
import numpy as np
from services.tools.campaign.file import metrics
from sim.evaluation.further import Positions, further
from services.reporting.differences import rows

at = np.zeros((4, 2))
found = further(Positions(np.arange(4.0), at, np.array([[0.0, 0.0], [0.05, 0.05], [0.3, 0.0], [0.0, 0.2]]), at))
assert found.within_10_cm_share == 0.5 and found.tracking_rms_m == 0.0
assert "further.within_10_cm_share" in metrics()
assert [row.values for row in rows([{"further": {"within_10_cm_share": 0.5}}])] == [(0.5,)]
""",
    "docs/add-plot.md": """
from matplotlib.figure import Figure
from msgspec.structs import replace
from ltv_mpc import Estimate
from benchmarks.paper.renderer import Run, draw
from services.reporting.plots.catalogue import SPEED, PLOTS
from services.reporting.plots.collector import Collector

collector = Collector()
for k in range(3):
    collector.add(replace(Estimate.at_rest(), velocity_north_mps=0.3, velocity_east_mps=0.4, t_ns=k * 100_000_000), 1)
tables = collector.all_tables()
assert tables["speed"]["speed_mps"] == [0.5] * 3
axes = Figure().subplots()
draw(axes, SPEED, [Run("dive", tables, collector.values, ())])
assert SPEED in PLOTS and axes.get_ylabel() == "speed (m/s)" and len(axes.lines) == 1
""",
}
"""Program for each page; it fails if the example does not work."""


WITHOUT_COMPILER = ("docs/add-cost-term.md", "docs/edges.md")
"""Pages that are tried in one process, the first of which turns the compiler off."""

COMPILED = tuple(page for page in OF_EACH if page not in WITHOUT_COMPILER)
"""Pages that are tried in another process: docs/edges.md and docs/add-command.md change the same line."""

ELSEWHERE = ("docs/add-limit.md",)
"""Page whose example is run by test_blocks.py as it stands."""


@pytest.mark.timeout(900)  # compiled code may have to be built first
@pytest.mark.parametrize("pages", [COMPILED, WITHOUT_COMPILER], ids=["compiled", "without compiler"])
def test_the_example_of_the_page_works(pages: Collection[str], tmp_path: Path) -> None:
    for page in pages:
        build(page, tmp_path)
    output = run("".join(f"exec(compile({OF_EACH[page]!r}, {page!r}, 'exec'), {{}})\n" for page in pages), tmp_path)
    assert ("--certs" in output) is ("docs/edges.md" in pages)
    assert ("  horizon" in output) is ("\n13.8 s\n" in output) is ("docs/add-command.md" in pages)


@pytest.mark.parametrize("page", [name for name in NAMES if name.startswith("docs/add-")])
def test_the_page_has_a_test(page: str) -> None:
    assert page in OF_EACH or page in ELSEWHERE
    assert f"]({Path(page).name})" in (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
