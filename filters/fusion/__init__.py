"""Fusion of beliefs whose errors are correlated in an unknown way."""
