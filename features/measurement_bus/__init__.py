"""Sensors that share a bus to one estimator, and filters under noise that grows with the state."""
