"""``python -m benchmarks.rivals``: see comparison.py, a module of its own because workers do not import this one."""

from benchmarks.rivals.comparison import main

main()
