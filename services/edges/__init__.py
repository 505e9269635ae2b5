"""Bridges between this bus and other message buses."""
