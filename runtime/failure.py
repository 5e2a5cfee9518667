"""The end of a command that no input of the user has caused."""


class RunFailed(Exception):
    """A failure whose message the command line prints before it ends with exit code 1."""
