"""Where the vehicle shall be: ``Point``, ``Hold``, and ``load`` for a file."""

from ltv_mpc.references.kinds import Hold, Point, Reference, load

__all__ = ["Hold", "Point", "Reference", "load"]
