"""Clusters and slot tables in files: TOML, FIBEX and AUTOSAR."""
