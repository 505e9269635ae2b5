"""Recordings of a run: writing, reading, recovering and exporting MCAP files."""
