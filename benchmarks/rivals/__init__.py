"""The controller against what people use instead, and against itself without one of its parts."""
