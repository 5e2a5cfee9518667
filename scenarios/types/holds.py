"""Hold policies: how a node uses the last share of a neighbour that is silent."""

from typing import Annotated

from concord.scenarios.types.option import Choice, Option


class Fading(Choice, frozen=True, kw_only=True, tag="decayed"):
    """Predict the held share to the present and lower its weight with its age."""

    decay: Annotated[
        float,
        Option(
            "Weight factor of a held share per cycle of age.",
            at_least=0,
            at_most=1,
            is_setting=True,
        ),
    ] = 0.5


class Decayed(Fading, frozen=True, kw_only=True, tag="decayed"):
    """Predict the held share to the present and lower its weight with its age."""

    determinant_weights: Annotated[
        bool, Option("Weigh beliefs by the size of their covariances too.")
    ] = True


class Predicted(Choice, frozen=True, kw_only=True, tag="predict"):
    """Predict the held share to the present and give it full weight."""


class Raw(Choice, frozen=True, kw_only=True, tag="raw"):
    """Take the held share for an estimate of the present, with full weight."""


class Dropped(Choice, frozen=True, kw_only=True, tag="drop"):
    """Give the weight of a silent neighbour to the node's own belief."""


class Renormalised(Choice, frozen=True, kw_only=True, tag="renormalise"):
    """Share the weight of a silent neighbour out among all beliefs that are present."""


class InStep(Choice, frozen=True, kw_only=True, tag="in-step"):
    """Use a held share within the step in which it came, and drop it afterwards."""


SimpleHold = Predicted | Raw | Dropped | Renormalised | InStep
BeliefHold = Decayed | SimpleHold
TrimmedHold = Fading | SimpleHold
Hold = BeliefHold | Fading
