"""Many vehicles on one machine: what each costs, and what gives way first."""
