"""Fault-injection campaign: faults drawn from a seed, injected from outside, and judged from the recorded messages."""
