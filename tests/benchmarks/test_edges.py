"""The foreign craft is driven through the edge to ROS 2, as processes, for some seconds."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("pymavlink", reason="not installed: pip install pymavlink (extra mavlink)")
pytest.importorskip("zenoh_ros2_sdk", reason="not installed: pip install zenoh-ros2-sdk (extra dev)")

from benchmarks import edges


@pytest.mark.timeout(400)
def test_the_craft_is_driven_through_an_edge_and_measured(tmp_path: Path) -> None:
    row = edges.measure("ros2", tmp_path, approach_s=2.0, hold_s=2.0, lap_s=5.0)
    assert 0.0 < row.progress < 0.2
    assert 20 <= row.estimates <= 200
    assert row.estimates_missing <= 2  # those under way at the end
    assert row.lost == row.refused == 0
    assert 0.0 <= row.estimate_ms[0] <= row.estimate_ms[1]
    assert 0.0 <= row.thrust_ms[0] <= row.thrust_ms[1]
    assert 0.0 < row.hold_m[0] <= row.hold_m[1] < 3.0
    assert 0.0 < row.square_m[0] <= row.square_m[1] < 3.0
    assert f"| `ros2` | {row.hold_m[0]:.3f}" in edges.text([row])
