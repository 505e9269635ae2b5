"""Stage timer: wall time of each stage of a controller cycle, which node and step loop name as it ends."""

from __future__ import annotations

import time

from services.runtime.lifeline import LIFELINE, Lifeline


class StageTimer:
    """``Stopwatch`` of a node: called with a stage's name when the stage ends. ``stage_us`` holds the newest cycle."""

    def __init__(self, lifeline: Lifeline = LIFELINE) -> None:
        self.stage_us: dict[str, float] = {}
        self._lifeline = lifeline
        self._last_ns = 0

    def start(self) -> None:
        """Begin a cycle."""
        self.stage_us = {}
        self.resume()

    def resume(self) -> None:
        """Discard the time since the last stage: it belongs to none."""
        self._last_ns = time.monotonic_ns()

    def __call__(self, stage: str) -> None:
        """End a stage. The times of a stage that occurs twice in a cycle are added."""
        now_ns = time.monotonic_ns()
        self.stage_us[stage] = self.stage_us.get(stage, 0.0) + (now_ns - self._last_ns) / 1000
        self._last_ns = now_ns
        self._lifeline.beat(now_ns // 1000)  # a step that makes progress does not hang
