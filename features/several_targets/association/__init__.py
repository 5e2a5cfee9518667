"""Which detection belongs to which track: gates, clusters, joint probabilities, best hypotheses."""
