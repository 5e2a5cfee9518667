"""Networks of processes under kills, hangs and malformed messages, for minutes or hours."""
