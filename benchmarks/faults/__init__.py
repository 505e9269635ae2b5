"""Fault campaign: faults injected in lock step and in processes on a bus, and the verdict on each."""
