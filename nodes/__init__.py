"""One node of the network and what drives it; imports filters and bus."""
