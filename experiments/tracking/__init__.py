"""Runs of several targets: tracks at a centre and at the nodes, and their scores."""
