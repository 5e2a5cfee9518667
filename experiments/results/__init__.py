"""What a run leaves: arrays, figures, tables and pictures."""
