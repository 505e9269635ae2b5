"""Localisation of a recorded dive without IMU: ADCP, its attitude and depth, and bottom track for the first fixes."""
