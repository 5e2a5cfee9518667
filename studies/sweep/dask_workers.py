"""Pieces of a sweep on the workers of a Dask cluster, which may be on other machines."""

import gc
import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from concord._version import __version__
from concord.studies.sweep.workers import Engine, WorkerLost

CONNECT_TIMEOUT_S = 10
# Workers that restart are away for some seconds.
_WITHOUT_WORKERS_S, _LOOK_EVERY_S, _WAIT_S = 60.0, 5.0, 0.5
TLS_FILES = {"tls_ca_file": "ca.pem", "tls_client_cert": "cert.pem", "tls_client_key": "key.pem"}


def connect(address: str, tls: Path | None = None, wait_s: float = 0.0) -> Engine:
    """Return the engine of the scheduler at `address`, such as tcp://10.0.0.1:8786.

    Args:
        address: of the scheduler; tls://10.0.0.1:8786 where it encrypts.
        tls: folder with the `TLS_FILES` of this client.
        wait_s: how long to wait for the first workers.

    Raises:
        ValueError: the extra is not installed, nobody answers, there are no workers, or they have
            another version of this program; files of TLS are missing.
    """
    files = _tls_files(address, tls)
    try:
        from distributed import Client, Security
    except ImportError:
        raise ValueError(
            "--dask needs Dask, which is not installed; run `make extras`, or "
            "`pip install '.[dask]'` in a checkout of concord, or leave --dask out to use the "
            "processes of this machine"
        ) from None
    client, refusal = None, ""
    # A client that nobody holds any more closes as it is collected. While another one starts, that
    # would wait for a lock which the start holds.
    gc.collect()
    try:
        # Without files, Dask's own configuration says which.
        security = Security(require_encryption=True, **files) if files else None
        # Not the default client: those that overlap leave a closed one in Dask's settings, and
        # xarray then looks for it when it writes a file.
        client = Client(address, timeout=CONNECT_TIMEOUT_S, security=security, set_as_default=False)
    except TypeError:
        # Dask's answer to an address of TLS without files.
        names = ", ".join(TLS_FILES.values())
        refusal = f"the scheduler encrypts; give --dask-tls FOLDER with {names}"
    except (OSError, ValueError) as error:
        refusal = (
            f"no scheduler answers ({error}); start one with `dask scheduler` and give the address "
            "that it prints"
        )
    if client is None:
        # So does the refused one, before the caller starts another.
        gc.collect()
        raise ValueError(f"--dask {address}: {refusal}")
    try:
        _wait_for_workers(client, address, wait_s)
        _check_workers(client, address)
    except BaseException:
        client.close()
        raise
    return partial(_over, client)


def _tls_files(address: str, tls: Path | None) -> dict[str, str]:
    if tls is None:
        return {}
    if not address.startswith("tls://"):
        raise ValueError(
            f"--dask {address} with --dask-tls {tls}: an encrypted scheduler has an address such "
            "as tls://HOST:8786; give that, or leave --dask-tls out"
        )
    for name in TLS_FILES.values():
        if not (tls / name).is_file():
            raise ValueError(
                f"--dask-tls {tls}: has no file {name}; put there {', '.join(TLS_FILES.values())}, "
                "which the scheduler's authority has signed"
            )
    return {option: str(tls / name) for option, name in TLS_FILES.items()}


def _wait_for_workers(client: Any, address: str, wait_s: float) -> None:
    """Wait until the scheduler has a worker; a line says so.

    Raises:
        ValueError: none has come in this time.
    """
    end_s, said = monotonic() + wait_s, False
    while not client.scheduler_info()["workers"]:
        if monotonic() >= end_s:
            raise ValueError(
                f"--dask {address}: it has no workers after {wait_s:g} s; start some: `dask worker "
                f"{address}`, or wait longer for a queue: --dask-wait SECONDS"
            )
        if not said:
            sys.stderr.write(
                f"waiting for workers of {address}, for {wait_s:g} s at most (--dask-wait)\n"
            )
            said = True
        sleep(min(_WAIT_S, wait_s))


def _check_workers(client: Any, address: str) -> None:
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
    # The last line of the command says that the scheduler is lost.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    # Not pure: Dask would answer equal pieces of another sweep from its memory.
    waiting = {client.submit(function, one, pure=False): n for n, one in enumerate(arguments)}
    try:
        while waiting:
            for done in _some_done(client, list(waiting)):
                # The cluster forgets a result with its last future.
                yield waiting.pop(done), _result(done)
                done.release()
    finally:
        client.cancel(list(waiting))
        client.close()


def _some_done(client: Any, futures: Sequence[Any]) -> Sequence[Any]:
    """Return the futures that are done, at least one of them.

    Raises:
        WorkerLost: there were no workers for some time.
    """
    from distributed import CancelledError, wait

    without_s = 0.0
    while True:
        try:
            with client.as_current():
                found: Any = wait(futures, _LOOK_EVERY_S, return_when="FIRST_COMPLETED")
            return list(found.done)
        except CancelledError:
            raise _scheduler_lost() from None
        except TimeoutError:
            alone = not client.scheduler_info()["workers"]
            without_s = without_s + _LOOK_EVERY_S if alone else 0.0
        if without_s >= _WITHOUT_WORKERS_S:
            raise WorkerLost(
                f"the Dask scheduler has been without workers for {without_s:.0f} s; start some"
            )


def _result(done: Any) -> Any:
    from distributed import CancelledError, KilledWorker
    from distributed.comm.core import CommClosedError

    try:
        return done.result()
    except KilledWorker:
        raise WorkerLost(
            "several Dask workers ended on one piece, most likely for want of memory"
        ) from None
    except (CancelledError, CommClosedError):
        raise _scheduler_lost() from None


def _scheduler_lost() -> WorkerLost:
    return WorkerLost("the Dask scheduler does not answer any more; start it again")
