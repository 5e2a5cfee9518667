"""Ways to a step: conditions at which a run stops, loops, and a pointer on the charts."""
