"""Start-up and clock synchronisation of a FlexRay cluster."""
