"""Studies of many runs: Monte Carlo, sweeps, designs, comparisons, checks."""
