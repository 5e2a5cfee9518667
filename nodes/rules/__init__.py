"""Fusion rules: what a node computes from its belief and the shares it holds."""
