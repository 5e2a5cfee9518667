"""Simulation testing of time and lives: processes that start, stop and die on a virtual clock."""
