"""Tracks of several targets at the nodes, from detections that are flooded or shared tracks."""
