"""The project's own study of labelled measurements."""
