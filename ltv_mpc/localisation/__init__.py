"""ADCP-aided localisation: one filter for the vehicle and the water."""
