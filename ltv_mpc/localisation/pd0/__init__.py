"""Recorded profiles of Teledyne RDI instruments in their format PD0: bytes to ensembles, ensembles to beams."""
