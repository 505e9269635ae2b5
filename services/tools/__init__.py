"""Offline tools: studies, checks and benchmarks that never run beside a vehicle."""
