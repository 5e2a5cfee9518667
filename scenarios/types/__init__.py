"""The typed values that a scenario is composed of; these files import none of the tables."""
