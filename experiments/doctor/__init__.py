"""What `concord doctor` looks at."""
