"""Static slots for frames with periods and deadlines, and for shares with an age to keep."""
