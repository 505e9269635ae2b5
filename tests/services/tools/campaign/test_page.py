"""Page of a campaign and ranking of its points, from synthetic rows."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from services.cli.app import run
from services.reporting import static_files
from services.tools.campaign import page
from services.tools.campaign.campaign import open_campaign, plan
from services.tools.campaign.file import load, points
from services.tools.campaign.ranking import interval, ranked, scores
from services.tools.campaign.trial import Row, Trial, row_of

FILE = """
title = "<b>made up</b>"
minimise = "true_error_m.mean"
seeds.count = 5
[vary]
controller.horizon_s = [2.5, 5.0, 10.0]
sensors = ["paper", "realistic"]
"""


def made_up(folder: Path) -> list[Row]:
    """Return rows of value horizon / 10, larger by 1 with realistic sensors, and an offset of each seed."""
    (folder / "c.toml").write_text(FILE)
    campaign = load(folder / "c.toml")
    hard = [0.0, 5.0, -3.0, 1.0, -1.0]
    rows = []
    for number, point in enumerate(points(campaign)):
        for seed in range(5):
            row = row_of(Trial(number, seed, point), "v")
            value = point["controller.horizon_s"] / 10 + (point["sensors"] == "realistic") + hard[seed]
            rows.append(row | {"true_error_m.mean": value})
    rows[7] |= {"true_error_m.mean": None, "failed": "no <such> thing"}  # point 1, seed 2
    with open_campaign(folder / "out", plan(campaign, "c.toml")) as store:
        for row in rows:
            store.append(f"point {row['point']}, seed {row['seed']}", row)
    return rows


def test_points_are_ordered_by_their_means_and_compared_by_the_seeds_that_both_have(tmp_path: Path) -> None:
    best = ranked(scores(made_up(tmp_path), "true_error_m.mean", ["controller.horizon_s", "sensors"]))
    assert [row.point for row in best] == [0, 2, 4, 3, 5, 1]  # point 1 has lost the seed that was easy for all
    by_point = {row.point: row for row in best}
    assert by_point[0].over_best is None
    # what a seed is hard by has dropped out, and point 1 is compared without the seed that it has lost
    assert by_point[1].over_best.mean == pytest.approx(1.0)
    assert by_point[1].over_best.high - by_point[1].over_best.low == pytest.approx(0.0, abs=1e-12)
    assert (by_point[1].runs, by_point[1].failed) == (5, 1)
    assert by_point[4].over_best.mean == pytest.approx(0.75)
    assert by_point[0].value.high - by_point[0].value.low > 1.0


def test_an_interval_holds_the_mean_of_what_it_was_drawn_from_in_95_of_100() -> None:
    """Of 20 values each: the percentile bootstrap is a little narrow then, 93 %."""
    rng = np.random.default_rng(8)
    held = [found.low < 3.0 < found.high for found in (interval(3.0 + rng.standard_normal(20)) for _ in range(400))]
    assert 0.90 < np.mean(held) < 0.97
    assert interval(np.array([2.0])).low is None


def test_the_page_has_a_panel_for_each_field_with_the_means_and_shows_what_failed(tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    made_up(tmp_path)
    assert run(["report", str(tmp_path / "out")]) == 0
    text = (tmp_path / "out" / page.NAME).read_text()
    assert "&lt;b&gt;made up" in text
    assert "<b>made up" not in text
    assert "1 failed: no &lt;such&gt; thing (point 1, seed 2)" in text
    own = text.replace(static_files.report_scripts()[0], "")
    assert not re.search(r'(src|href)="(http|//)', own)
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])
    horizon, sensors = data["plots"]
    labels = [series["label"] for series in horizon["series"] if series["style"] == "line"]
    assert labels == ["sensors paper", "sensors realistic"]
    paper = data["runs"][0]["tables"][horizon["series"][0]["table"]]
    assert paper["x"] == [2.5, 5.0, 10.0]
    assert paper["mean"] == pytest.approx([0.4 + 0.25, 0.4 + 0.5, 0.4 + 1.0])
    assert all(low < mean < high for low, mean, high in zip(paper["low"], paper["mean"], paper["high"], strict=True))
    assert sensors["x"]["rows"] == ["paper", "realistic"]
