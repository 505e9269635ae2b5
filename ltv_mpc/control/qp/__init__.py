"""The quadratic programme of one cycle: what it is, its layout, how well it was solved."""
