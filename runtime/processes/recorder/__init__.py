"""The recorder process: it keeps all messages, and lets others watch."""
