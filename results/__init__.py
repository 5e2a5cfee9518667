"""Results of a run: arrays, figures, tables and pictures."""
