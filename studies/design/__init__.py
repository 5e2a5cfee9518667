"""The search for the cheapest network that meets an error target."""
