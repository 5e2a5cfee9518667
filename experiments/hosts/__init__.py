"""A network on several hosts from one file: over ssh, or as files of other programs."""
