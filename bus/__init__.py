"""FlexRay: what may be said, when, and in which bytes; imports nothing of ours."""
