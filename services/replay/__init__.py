"""A run's pure nodes fed again what was recorded: every output byte for byte, or what another setting would do."""
