"""A rule, a scenario and a command for concord."""
