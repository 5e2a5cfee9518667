"""CAN FD: frames whose identifiers arbitrate for the bus."""
