"""Options of recorded robots."""

from typing import Annotated

from concord.scenarios.types.option import Option
from concord.scenarios.types.plants import DATA, SensedPlantChoice


class RecordedRobots(SensedPlantChoice, frozen=True, kw_only=True, tag="mrclam"):
    """Four real robots track the fifth; needs --data and --target."""

    target: Annotated[int, Option("The robot to be tracked, 1 to 5.")] = 1
    data: Annotated[str | None, DATA] = None
