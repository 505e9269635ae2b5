"""Supervisor of a run: starts all processes, restarts the ones that die or hang, and stops them in order.

The run      supervisor, process_table, failure_handler (restarts), bus_monitor (newest messages), screen
A process    child_processes, managed_process (one child), hang_detector, forkserver, entry_point, parent_death
Preparation  jit_cache, loopback
"""
