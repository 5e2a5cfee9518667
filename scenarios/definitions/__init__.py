"""The scenario definitions, and the parts that several of them share."""
