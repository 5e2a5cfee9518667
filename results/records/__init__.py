"""Records of runs as arrays, and their files."""
