"""Study of fences: random scenes, flown by the controller and by its rivals (docs/notes/fences-study.md)."""
