"""What the bus carried, from the record of a run."""
