"""Entry points of the processes of a run, one file a process."""
