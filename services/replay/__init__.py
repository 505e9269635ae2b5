"""Replay of a recording: its pure nodes step again on the recorded inputs.

Either every output is compared with the recorded one, byte for byte (``replay.replay``), or one node runs with other
settings and its outputs are compared by value (``replay.what_if``).
"""
