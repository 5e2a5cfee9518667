"""Graphs, weights and their analysis; imports no other package of the project."""
