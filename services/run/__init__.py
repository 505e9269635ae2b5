"""Folder of a run: its files, its provenance and its summary."""
