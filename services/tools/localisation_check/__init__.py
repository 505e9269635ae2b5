"""Consistency of the localisation over many seeds (`ltv-mpc localisation-check`)."""
