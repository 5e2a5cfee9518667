"""The environment process: plant, sensors and arbiter of a network of processes."""
