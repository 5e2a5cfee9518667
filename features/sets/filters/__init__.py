"""Sets that contain the state with certainty: ellipsoids and zonotopes."""
