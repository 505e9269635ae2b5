"""Checks between estimates, controller and actuators: gates, input monitors, command arbiter, model monitor."""
