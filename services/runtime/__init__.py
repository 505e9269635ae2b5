"""One process of a run: a node on the bus, by the vehicle clock."""
