"""The panels beside the scene."""
