"""Kinds of share: what the vectors of a rule are, and their forms on the wire."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from concord.filters.fusion.packed import packed_length
from concord.nodes.share_forms import (
    ShareForm,
    SingleBelief,
    StackedBelief,
    TwoByteBelief,
    TwoByteHybrid,
    TwoByteInformation,
)
from concord.nodes.vector_codec import VectorCodec

FormOf = Callable[[int, int], ShareForm]
"""The form for so many states and nodes."""


class ShareKind(NamedTuple):
    """A kind of share.

    Attributes:
        what: its name in reports of shares that cannot be used.
        length: how many numbers are in a share, for so many states and nodes.
        forms: its form by type code; a float type without one is written number by number.
    """

    what: str
    length: Callable[[int, int], int]
    forms: Mapping[str, FormOf] = {}

    def codec(self, number: str, states: int, nodes: int, models: int = 1) -> VectorCodec:
        """How a share is written; of beliefs of several models, all that is not known of it."""
        if models > 1:
            stacked = StackedBelief(states, models, number == "<f4")
            return VectorCodec(packed_length(stacked.size), number, self.what, stacked)
        form = self.forms.get(number)
        made = None if form is None else form(states, nodes)
        return VectorCodec(self.length(states, nodes), number, self.what, made)

    def has(self, number: str) -> bool:
        """Whether shares of this kind can be written so."""
        return np.dtype(number).kind == "f" or number in self.forms


BELIEFS = ShareKind(
    "belief",
    lambda states, _: packed_length(states),
    {"<f4": lambda states, _: SingleBelief(states), "<u2": lambda states, _: TwoByteBelief(states)},
)
INFORMATION_PAIRS = ShareKind(
    "share",
    lambda states, _: packed_length(states),
    {"<u2": lambda states, _: TwoByteInformation(states)},
)
HYBRID = ShareKind(
    "share",
    lambda states, nodes: 2 * packed_length(states) + nodes,
    {"<u2": TwoByteHybrid},
)
NOVELTIES = ShareKind("share", lambda states, _: packed_length(states))
NOVELTIES_AND_MEANS = ShareKind("share", lambda states, _: packed_length(states) + states)
