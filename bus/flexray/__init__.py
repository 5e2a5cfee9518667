"""FlexRay: cluster, schedule, arbitration, frames and timing."""
