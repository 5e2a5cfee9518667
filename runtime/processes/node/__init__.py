"""The process of one node, in lockstep or in real time."""
