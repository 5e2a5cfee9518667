"""Nodes, environment and recorder as operating-system processes."""
