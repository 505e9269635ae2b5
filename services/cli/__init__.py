"""Command line ``ltv-mpc``: parses options, calls one function and prints its result."""
