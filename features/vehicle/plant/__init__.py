"""A car: its model, its sensors, its drives."""
