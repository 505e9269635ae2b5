"""What the instruments say of the truth: one file a sensor, each with equations and random numbers of its own."""
