"""The pages "How to add ...": the example of each, built from the page alone, works."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.docs.changed_tree import build, run
from tests.docs.pages import NAMES, ROOT

DIVE = """
import json
import numpy as np
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.messages import Estimate, Truth
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from sim.scheduler import LockStep, Observation

class Errors:
    def __init__(self):
        self.truth, self.errors = {}, []
    def published(self, node, received):
        message = received.message
        if isinstance(message, Truth):
            self.truth = {message.t_ns: message.position_m}
        elif isinstance(message, Estimate) and message.t_ns > 0 and message.t_ns in self.truth:
            north, east, _ = self.truth[message.t_ns]
            self.errors.append((message.north_m - north) ** 2 + (message.east_m - east) ** 2)

for sensors in ("./with_log.toml", "realistic"):
    settings = ["run.duration_s=30", "run.seed=3", f"sensors={sensors}"]
    situation = resolve("descent", [Override("test", settings)])
    errors, nodes = Errors(), make_nodes(situation, publish_unread_topics=False)
    scenario = situation.scenario
    LockStep(nodes, start_ns=scenario.start_ns, observation=Observation(errors)).advance(scenario.end_ns)
    estimator = next(node for node in nodes if isinstance(node, Estimator))
    print(json.dumps({"account": dict(estimator.account), "rms_m": float(np.sqrt(np.mean(errors.errors)))}))
"""


TESTS_OF_THE_SENSOR = """
from services.bus import protocol
from services.reporting.plots.collector import NIS
from tests.ltv_mpc.localisation.sensors import test_jacobians, test_registry
from tests.services.bus import test_wire

test_registry.test_each_sensor_stands_under_its_name_with_its_settings()
test_registry.test_each_sensor_has_a_topic_and_a_simulation()
test_registry.test_the_example_of_a_vehicle_at_rest_leaves_no_residual("speed_log")
test_jacobians.test_partials_are_minus_the_derivatives_of_the_residual("speed_log")
test_wire.test_every_topic_has_an_example_here()
assert "speed_log" in NIS
assert "LogSpeed" in protocol.page()
"""


@pytest.mark.timeout(900)  # compiled code may have to be built first
def test_the_sensor_passes_the_tests_of_each_is_used_and_does_not_worsen_the_estimate(tmp_path: Path) -> None:
    build("docs/add-sensor.md", tmp_path)
    with_log, without = map(json.loads, run(TESTS_OF_THE_SENSOR + DIVE, tmp_path).splitlines())
    assert with_log["account"]["speed_log.used"] > 140  # of 150 in 30 s at 5 Hz
    assert "speed_log.used" not in without["account"]
    assert with_log["rms_m"] < 1.05 * without["rms_m"]


OF_EACH = {
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

test_terms.test_the_model_has_value_and_slope_of_the_exact_term("yaw_rate", 0)
test_terms.test_all_terms_are_in_cost_and_problem()
for name in test_terms.SOLVERS:
    test_terms.test_every_solver_feels_it("yaw_rate", name)
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
    "docs/add-topic.md": """
from ltv_mpc.messages import WaterTemperature
from services.bus import protocol, wire
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
assert "WaterTemperature" in protocol.page()
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


ELSEWHERE = ("docs/add-sensor.md", "docs/add-limit.md")
"""Pages whose example has tests above, or is run by test_blocks.py as it stands."""


@pytest.mark.parametrize("page", OF_EACH)
def test_the_example_of_the_page_works(page: str, tmp_path: Path) -> None:
    build(page, tmp_path)
    output = run(OF_EACH[page], tmp_path)
    if page == "docs/add-command.md":
        assert "  horizon" in output
        assert output.endswith("13.8 s\n")


@pytest.mark.parametrize("page", [name for name in NAMES if name.startswith("docs/add-")])
def test_the_page_has_a_test(page: str) -> None:
    assert page in OF_EACH or page in ELSEWHERE
    assert f"]({Path(page).name})" in (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
