"""A car: its models, drives, logs and adaptive filters."""
