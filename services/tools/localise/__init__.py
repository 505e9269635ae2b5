"""Localisation of a recorded dive (`ltv-mpc localise`)."""
