"""The result of a sweep as a page: its cells, their runs, and a press from a run to its page."""
