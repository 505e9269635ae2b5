"""Which horizon, when: docs/horizon.md."""
