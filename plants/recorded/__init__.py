"""Plants whose truth was recorded: readers of data sets."""
