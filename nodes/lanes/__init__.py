"""The array forms of the rules, for all nodes of many runs."""
