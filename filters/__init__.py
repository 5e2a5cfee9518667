"""Mathematics of one belief; imports nothing of ours."""
