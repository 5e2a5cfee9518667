"""Many runs: simulation, figures and intervals."""
