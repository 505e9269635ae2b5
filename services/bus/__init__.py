"""Message bus: topics, encoding, validation, sessions and security."""
