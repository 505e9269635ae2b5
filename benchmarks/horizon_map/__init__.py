"""Map of the best horizon by situation, for docs/horizon.md."""
