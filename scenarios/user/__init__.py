"""Values from a user's own files: how they are found, and an own bus."""
