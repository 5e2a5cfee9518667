"""Recorded bus signals: waveforms, decoder, fit and capture files."""
