"""Study of fences: random scenes, flown by the controller (docs/notes/fences-study.md)."""
