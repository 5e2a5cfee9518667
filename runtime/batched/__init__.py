"""The batched driver: all nodes of many runs as arrays."""
