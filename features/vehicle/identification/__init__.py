"""Identification of a car, its sensors and its process noise from a logged drive."""
