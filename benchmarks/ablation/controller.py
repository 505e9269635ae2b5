"""Mechanisms of the controller."""

from __future__ import annotations

from benchmarks.ablation.mechanism import Mechanism

MECHANISMS: tuple[Mechanism, ...] = ()
