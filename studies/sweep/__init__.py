"""Sweeps: cells, pieces, workers, results and plots."""
