"""FlexRay: clusters, slots, frames, clocks and times."""
