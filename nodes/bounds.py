"""What any message may be at most, whoever sent it: sizes and ranges, refused before it is used."""

from typing import Annotated

from msgspec import Meta

# An estimate of a hundred states takes about 120 kB of JSON.
MAX_MESSAGE_BYTES = 1 << 20
# The longest FlexRay frame: header (5), payload (254), checksum (3).
MAX_FRAME_BYTES = 262

NodeIndex = Annotated[int, Meta(ge=0, lt=1 << 16)]
# Steps and cycles: a cycle number has four bytes in a frame.
Instant = Annotated[int, Meta(ge=0, lt=1 << 32)]
Group = Annotated[int, Meta(ge=0, lt=1 << 16)]
NodeList = Annotated[list[NodeIndex], Meta(max_length=1 << 16)]
