"""Tests of the identification of a car."""
