"""Runtime of one process: a pure node on the bus, stepped by the vehicle clock.

    bus -> Mailbox -> input_receiver -> node_io: inbox -> step of the node -> node_io: record, then outputs -> bus

The loop     runner, stage_timer (time of each stage of a cycle)
Vehicle time process_time (clock and schedule of a process); clock, followed, and clock_master, which announces it;
             clock_sync and clock_offset, without an announced one
Reports      node_status, of every process; controller_status with controller_changes and metrics; console
A process    serve, stopping, lifeline (to what has started it)
The recorder recording_loop
"""
