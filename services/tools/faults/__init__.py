"""The campaign of faults: drawn by a seed, injected from outside, each judged by what the run's own messages show."""
