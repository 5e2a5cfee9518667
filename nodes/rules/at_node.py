"""A fusion rule at one node: batch () of its lanes, with shares as bytes."""

from dataclasses import dataclass
from functools import cached_property
from typing import Generic, cast

import numpy as np

from concord.filters.filter import Filter, begun, moments
from concord.filters.gaussian import Gaussian
from concord.nodes.messages import Measured, from_wire
from concord.nodes.rules.lane_rule import (
    AveragesShares,
    Held,
    LaneContent,
    LaneRule,
    LocalStep,
    Own,
    Place,
    Share,
    asked,
    mapped,
)
from concord.nodes.rules.local_filter import (
    LocalFilters,
    Model,
    Sensor,
    SensorGroup,
    control_of,
    failure_names,
)
from concord.nodes.vector_codec import VectorCodec

_SENDS = np.array(True)


@dataclass(frozen=True)
class AtNode(Generic[Own, Held, Share]):
    """The estimator of a rule at a node (`concord.nodes.estimator.Estimator`)."""

    rule: LaneRule[Own, Held, Share]
    place: Place
    model: Model
    sensor: Sensor | None
    prior: Gaussian
    filter: Filter
    codec: VectorCodec

    @property
    def share_bytes(self) -> int:
        """Length of an encoded share."""
        return self.codec.size

    @property
    def neighbours(self) -> int:
        """How many neighbours the node has."""
        return self.place.weights.shape[-1] - 1

    def start(self) -> LaneContent[Own, Held]:
        """The prior, and neighbours never heard."""
        prior = begun(self.filter, self.prior)
        mean, cov = prior
        held = Gaussian(
            np.repeat(mean[None], self.neighbours, axis=0),
            np.repeat(cov[None], self.neighbours, axis=0),
        )
        return self.rule.start(self.place.node, prior, held)

    def begin_step(
        self, content: LaneContent[Own, Held], measured: Measured
    ) -> tuple[LaneContent[Own, Held], tuple[str, ...]]:
        """Carry everything to this step and take the own readings."""
        # Mostly nothing was taken, and to find that out in an array takes longer.
        taken = [reading for reading in measured.readings if any(v is not None for v in reading)]
        readings = from_wire(taken) if taken else np.empty((0, 0))
        now = LocalStep(self._filters, readings, control_of(measured), measured.step)
        content, failures = self.rule.begin_step(self.place.node, content, now)
        return content, failure_names(failures)

    @cached_property
    def _filters(self) -> LocalFilters:
        groups = () if self.sensor is None else (SensorGroup(slice(None), self.sensor),)
        return LocalFilters(self.model, groups, self.filter)

    def bid(self, content: LaneContent[Own, Held]) -> int | None:
        """How urgent a dynamic slot is (None: nothing to send)."""
        return asked(self.rule.bid(content))

    def compose(self, content: LaneContent[Own, Held]) -> tuple[LaneContent[Own, Held], bytes]:
        """Return the share to send now; remember what neighbours will hold of this node."""
        return self.rule.sent(content, _SENDS), self.codec.encode(self.rule.say(content))

    def next_bytes(self, content: LaneContent[Own, Held]) -> int:
        """The length of every share."""
        return self.share_bytes

    def accept(self, body: bytes) -> bytes:
        """A body of which numbers can be read (`VectorCodec.check`)."""
        return self.codec.check(body)

    def fuse(
        self, content: LaneContent[Own, Held], shares: tuple[bytes | None, ...]
    ) -> tuple[LaneContent[Own, Held], tuple[str, ...]]:
        """End a round with bodies that were accepted, in the order of the neighbours."""
        came = self.codec.unpack(*[share for share in shares if share is not None])
        heard = np.array([share is not None for share in shares], dtype=bool)
        decoded, sound, reason = self.rule.read(came)
        again: tuple[str, ...] = ()
        if sound is not None and not sound.all():
            again = (f"rejected {reason}",) * int((~sound).sum())
        if len(came) < len(shares):
            decoded = mapped(lambda values: _placed(values, heard), decoded)
        if again:
            heard = heard & _placed(cast(np.ndarray, sound), heard)
        content, failures = self.rule.fuse(self.place, content, decoded, heard)
        return content, again + failure_names(failures) if failures or again else ()

    def belief(self, content: LaneContent[Own, Held]) -> Gaussian:
        """The node's belief now."""
        return moments(self.filter, self.rule.belief(content))

    def ages(self, content: LaneContent[Own, Held]) -> np.ndarray:
        """Cycles since the last share of each neighbour was sent; -1 is never."""
        return self.rule.ages(content)

    def weights(self, content: LaneContent[Own, Held]) -> np.ndarray | None:
        """Weights (J,) of the neighbours in the last round, of a rule that averages."""
        return self._averaging.weights(self.place, content) if self._averaging else None

    @cached_property
    def _averaging(self) -> AveragesShares | None:
        return self.rule if isinstance(self.rule, AveragesShares) else None


def _placed(values: np.ndarray, heard: np.ndarray) -> np.ndarray:
    """Values (C, ...) of the neighbours that were heard (J,), in the places of all (J, ...)."""
    found = np.zeros((len(heard), *values.shape[1:]), values.dtype)
    found[heard] = values
    return found
