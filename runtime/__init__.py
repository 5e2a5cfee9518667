"""What drives node and environment: in process, batched, or as processes over zenoh."""
