"""Ablation study: every optional mechanism is switched off alone, in runs that contain the event it exists for."""
