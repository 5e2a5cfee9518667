"""Entries of this folder (`concord.entries`)."""
