"""Edges: converters between this bus and the messages of other systems. They know no network, clock or thread."""
