"""The world outside the vehicle: deleted the day the real vehicle and the real sea arrive."""
