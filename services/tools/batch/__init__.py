"""Many independent runs: one executor, and one results store that an interrupted batch continues from."""
