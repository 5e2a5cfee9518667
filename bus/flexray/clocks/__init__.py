"""Clocks of the nodes of a FlexRay cluster: synchronisation and start-up."""
