"""A package of entries outside the repository."""
