"""The developers' laboratory: networks under drawn faults, kills, hangs and malformed messages."""
