"""Filters at the receiver of a measurement bus."""
