"""Plants with a controller, and the design of their controllers."""
