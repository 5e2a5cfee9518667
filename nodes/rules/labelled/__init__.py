"""The rule `labelled`: measurements travel, each labelled by its source and step."""
