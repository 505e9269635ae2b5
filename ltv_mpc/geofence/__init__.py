"""Geofence: keep-in and keep-out zones with their margins, and the half-planes that keep a predicted track out of them.

A zone is a polygon, which may be concave, or a disc. The vehicle stays inside every keep-in zone and outside every
keep-out zone.
"""
