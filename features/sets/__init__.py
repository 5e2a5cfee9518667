"""Sets that hold the truth for certain: ellipsoids, zonotopes, their rules and receivers."""
