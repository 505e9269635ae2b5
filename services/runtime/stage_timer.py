"""Stages of one controller cycle on the wall clock: the node names them as they end, the runner adds its own."""

from __future__ import annotations

import time

from services.runtime.supervisor_link import SUPERVISOR_LINK


class StageTimer:
    """A ``Stopwatch``: call it with a stage's name when that stage ends. ``stage_us`` holds the newest cycle."""

    def __init__(self) -> None:
        self.stage_us: dict[str, float] = {}
        self._last_ns = 0

    def start(self) -> None:
        """A cycle begins."""
        self.stage_us = {}
        self.resume()

    def resume(self) -> None:
        """Time since the last stage belongs to none."""
        self._last_ns = time.monotonic_ns()

    def __call__(self, stage: str) -> None:
        """``stage`` ends; a stage that comes twice in a cycle adds up."""
        now_ns = time.monotonic_ns()
        self.stage_us[stage] = self.stage_us.get(stage, 0.0) + (now_ns - self._last_ns) / 1000
        self._last_ns = now_ns
        SUPERVISOR_LINK.beat(now_ns // 1000)  # a step that gets on is no hang
