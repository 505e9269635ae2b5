"""Real dive of a glider, with parameters fixed before the filter first ran on it."""

from __future__ import annotations

from pathlib import Path

import pytest

from services.tools.localise.dive_localisation import localise

DIVE = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "PF230519.PD0"


@pytest.mark.skipif(not DIVE.exists(), reason=f"{DIVE} is not there: the recording is kept beside the checkout")
def test_a_glider_is_localised_within_six_metres_after_300_s_from_most_starts():
    """Bottom track of the first ten ensembles; the rest is the truth: measured 4.3 m, constant velocity 10.7 m."""
    result = localise(DIVE, fixes=10, start_depth_m=None).result
    assert (result.ensembles, result.lost_bytes) == (175, 0)
    study = result.study
    assert study is not None
    assert study.starts >= 11
    assert study.median_error_m <= 6.0
    assert study.ratio is not None
    assert study.ratio <= 0.6
    assert study.inside_3_sigma >= 0.95
