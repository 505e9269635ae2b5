"""Edges to other message buses."""
