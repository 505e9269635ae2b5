"""Runtime of one process: a pure node on the bus, stepped by the vehicle clock."""
