"""Latency profile of a controller cycle, by solver and horizon (`ltv-mpc profile`)."""
