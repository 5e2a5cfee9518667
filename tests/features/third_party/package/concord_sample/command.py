"""A command."""

import sys
from typing import Annotated

import tyro


def greet(name: Annotated[str, tyro.conf.Positional]) -> None:
    """Greet a user by name.

    Args:
        name: The user's name.
    """
    sys.stdout.write(f"good day, {name}\n")
