"""Command line ``ltv-mpc``: parses options, calls one function and prints its result."""

from importlib.util import find_spec

NEEDED = ("msgspec", "typer")
"""Packages without which no command has options, ``doctor`` neither, which names all others that are missing."""

if missing := [name for name in NEEDED if find_spec(name) is None]:
    raise SystemExit(f"ltv-mpc: {missing[0]} is not installed: run `make setup`, or install the wheel again")
