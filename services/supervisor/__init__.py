"""Supervisor of a run: starts all processes, restarts the ones that die or hang, and stops them in order.

The run      supervisor, process_table, process_group (restarts, stop), bus_monitor (newest messages), screen
A process    child, managed_process (heartbeats), forkserver, entry_point, parent_death
Preparation  jit_cache, loopback
"""
