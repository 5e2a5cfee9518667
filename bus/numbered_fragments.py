"""Fragments of shares as every bus reads them: a mistake in their numbers is a reason to reject."""

from collections.abc import Sequence

from concord.bus.bus import Rejected, SharePlace
from concord.bus.fragments import FragmentError, fragment_count, join


def numbered(data: bytes) -> SharePlace:
    """Return where a fragment says that it belongs in its share.

    Raises:
        Rejected: the fragment is too short to say.
    """
    try:
        frames = fragment_count(data)
    except FragmentError as error:
        raise Rejected(f"fragment-{error.reason}") from None
    return SharePlace(data[0], frames)


def read_body(fragments: Sequence[bytes]) -> bytes:
    """Return the body of a share whose fragments have all come.

    Raises:
        Rejected: they do not belong together.
    """
    try:
        return join(fragments)
    except FragmentError as error:
        raise Rejected(f"fragment-{error.reason}") from None
