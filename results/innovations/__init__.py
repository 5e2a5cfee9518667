"""Innovations of a run: tests, the cause that they point to, figures, and the verdict."""
