"""The page "How to add a sensor": its example, built from the page alone, is used in a dive.

The changed files stand in a folder of their own, in front of the packages, so that compiled code stays valid.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.pages import ROOT, blocks

PAGE = "docs/add-sensor.md"
DIVE = """
import importlib.util, json, sys
from pathlib import Path
import numpy as np

class Changed:
    '''Finder of the modules that the page has changed or added.'''
    @staticmethod
    def find_spec(name, path=None, target=None):
        part = name.replace(".", "/")
        for file, is_package in ((f"{part}/__init__.py", True), (f"{part}.py", False)):
            if Path(file).is_file():
                where = [str(Path(part).resolve()), f"{sys.argv[1]}/{part}"] if is_package else None
                file = Path(file).resolve()
                return importlib.util.spec_from_file_location(name, file, submodule_search_locations=where)
        return None

sys.meta_path.insert(0, Changed)
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
    errors, nodes = Errors(), make_nodes(situation, unread=False)
    scenario = situation.scenario
    LockStep(nodes, start_ns=scenario.start_ns, observation=Observation(errors)).advance(scenario.end_ns)
    estimator = next(node for node in nodes if isinstance(node, Estimator))
    print(json.dumps({"account": dict(estimator.account), "rms_m": float(np.sqrt(np.mean(errors.errors)))}))
"""


def apply(text: str, folder: Path) -> None:
    """Apply one block of the page: insert the new lines at their context, or create the file."""
    head, *lines = text.splitlines()
    name = head.removeprefix("# ")
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    context = [line[1:] for line in lines if not line.startswith("+")]
    new = [line[1:] for line in lines]
    if not context:
        assert not (ROOT / name).exists(), f"{name}: the page does not say where its lines belong"
        path.write_text("\n".join(new) + "\n", encoding="utf-8")
        return
    old = (path if path.exists() else ROOT / name).read_text(encoding="utf-8")
    place = "\n".join(context) + "\n"
    assert old.count(place) == 1, f"{name}: {old.count(place)} places are\n{place}"
    path.write_text(old.replace(place, "\n".join(new) + "\n"), encoding="utf-8")


@pytest.mark.timeout(900)  # compiled code may have to be built first
def test_the_sensor_of_the_page_is_used_and_does_not_worsen_the_estimate(tmp_path: Path) -> None:
    for block in blocks(PAGE):
        apply(block.text, tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", DIVE, str(ROOT)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    with_log, without = map(json.loads, done.stdout.splitlines())
    assert with_log["account"]["speed_log.used"] > 140  # of 150 in 30 s at 5 Hz
    assert "speed_log.used" not in without["account"]
    assert with_log["rms_m"] < 1.05 * without["rms_m"]


def test_the_page_is_short() -> None:
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    for block in blocks(PAGE):
        text = text.replace(block.text, "")
    assert len(text.split()) <= 400
