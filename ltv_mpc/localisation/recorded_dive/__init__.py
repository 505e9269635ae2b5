"""A recorded dive without an inertial unit: a profiler, its attitude and depth, bottom track for the first fixes."""
