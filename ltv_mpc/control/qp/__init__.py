"""The quadratic programme of one cycle: what it is, how it is laid out for a solver, how well it was solved."""
