"""The live page: what a bus carries, drawn in a browser on this machine, and a few buttons for who holds the token."""
