"""Faults that happen outside the code under test: in instruments, on the way, in the solver, in the plant's world."""
