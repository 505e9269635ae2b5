"""Measurement models of the sensors, one file a sensor."""
