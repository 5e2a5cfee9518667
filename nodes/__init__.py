"""The state machines of node and environment, and the fusion rules; imports filters and bus."""
