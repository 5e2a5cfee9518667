"""The zenoh network of a run: links, transport, access control."""
