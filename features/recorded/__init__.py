"""Recorded robots (UTIAS MRCLAM) and the sensors of the Intel laboratory."""
