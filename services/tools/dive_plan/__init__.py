"""Plan of a dive: expected drift, error budget and gains, from the Cramer-Rao bound along simulated dives."""
