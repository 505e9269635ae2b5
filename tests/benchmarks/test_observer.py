"""Consistency of the disturbance observer and alarm of a wrong file: a few runs of ``benchmarks/observer.py``."""

from __future__ import annotations

import pytest

from benchmarks.observer import judged
from benchmarks.robustness.cases import RIGHT
from benchmarks.robustness.flights import Row


def test_a_right_file_is_not_named_and_its_innovations_are_within_their_covariance() -> None:
    runs = [judged((Row("surface", "square", RIGHT), seed)) for seed in (1, 2)]
    assert all(run.named == "" and 0.2 < run.nis < 3.0 and run.many < 0.01 for run in runs)


@pytest.mark.parametrize(("case", "named"), [("drag=0.5", "drag ahead"), ("mass=2", "m")])
def test_a_wrong_file_is_named_within_30_s_of_its_second_corner(case: str, named: str) -> None:
    run = judged((Row("surface", "square", case), 1))
    assert run.named.startswith(named)
    assert run.after_s < 30.0
