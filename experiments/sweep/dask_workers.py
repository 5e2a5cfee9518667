"""Pieces of a sweep on the workers of a Dask cluster, which may be on other machines."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from concord._version import __version__
from concord.experiments.sweep.workers import Engine

CONNECT_TIMEOUT_S = 10


def connect(address: str) -> Engine:
    """Return the engine of the scheduler at `address`, such as tcp://10.0.0.1:8786.

    Raises:
        ValueError: the extra is not installed, nobody answers, there are no workers, or they have
            another version of this program.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ValueError(
            "--dask needs Dask, which is not installed; run `make extras`, or "
            "`pip install '.[dask]'` in a checkout of concord, or leave --dask out to use the "
            "processes of this machine"
        ) from None
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"--dask {address}: no scheduler answers ({error}); start one with `dask scheduler` "
            "and give the address that it prints"
        ) from None
    try:
        _check_workers(client, address)
    except ValueError:
        client.close()
        raise
    return partial(_over, client)


def _check_workers(client: Any, address: str) -> None:
    workers = list(client.scheduler_info()["workers"])
    if not workers:
        raise ValueError(
            f"--dask {address}: it has no workers; start some: `dask worker {address}`"
        )
    try:
        versions = client.run(_version)
    except Exception as error:
        raise ValueError(
            f"--dask {address}: its workers do not have concord ({error}); install it there"
        ) from None
    others = {worker: v for worker, v in versions.items() if v != __version__}
    if others:
        worker, theirs = next(iter(others.items()))
        raise ValueError(
            f"--dask {address}: worker {worker} has concord {theirs}, and here is "
            f"{__version__}; results of two versions cannot stand side by side"
        )


def _version() -> str:
    return __version__


def _over(
    client: Any, function: Callable[[Any], Any], arguments: Sequence[Any]
) -> Iterator[tuple[int, Any]]:
    from distributed import as_completed

    # Not pure: Dask would answer equal pieces of another sweep from its memory.
    waiting = {client.submit(function, one, pure=False): n for n, one in enumerate(arguments)}
    try:
        for done in as_completed(list(waiting)):
            # The cluster forgets a result with its last future.
            yield waiting.pop(done), done.result()
            done.release()
    finally:
        client.cancel(list(waiting))
        client.close()
