"""A page in the browser that reads messages, live or recorded; imports what is below it."""
