"""Fleet trial: many vehicles on one machine, their processor time, and the resource that limits their number."""
