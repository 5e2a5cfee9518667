"""Conformance of a user's rule or scenario: one table of promises, each checked in drawn cases."""
