"""Drivers of nodes and environment: in process, batched, or as processes over zenoh."""
