"""The dashboard: a viser page that reads messages, live or recorded; may import what is below it."""
