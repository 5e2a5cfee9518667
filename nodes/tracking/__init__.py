"""Tracks of several targets at the nodes of a network, from detections that are flooded."""
