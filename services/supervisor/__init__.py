"""Supervisor of a run: starts all processes, restarts the ones that die or hang, and stops them in order."""
