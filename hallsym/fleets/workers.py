"""Work spread over processes or a cluster: the executors of `concurrent.futures`, and one loop.

Locally a spawned `ProcessPoolExecutor`; on a cluster `dask.distributed.Client(address).get_executor()`. Only
this is added: where a local process dies, its pool is broken and a new one goes on; work that was under way
then runs alone, and what ends its process again is named.
"""

import os
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TypeVar

from hallsym.errors import InputError, summary

Work = TypeVar("Work")
Result = TypeVar("Result")

ANSWERS = 10.0
"""Time [s] within which a scheduler must answer."""
ENDED = "Its process was ended twice, as by a system that is out of memory; look at this log by itself."
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables by which linear algebra takes one thread: the processes are the parallelism."""


@dataclass(frozen=True)
class Failed:
    """Work that gave no result, and why."""

    reason: str


def completed(
    call: Callable[[Work], Result],
    work: Iterable[Work],
    *,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[tuple[Work, Result | Failed]]:
    """Yield every piece of work with `call(one)` as it is done, in any order.

    `call` and work are sent to other processes: a function of a module, and small things. `workers`: local
    processes, one a core by default. `scheduler`: address of a Dask scheduler, used instead. Raises
    `InputError` for a scheduler that does not answer.
    """
    left = list(work)
    if scheduler is not None:
        with _cluster(scheduler) as executor:
            yield from _pass(executor, call, left)
        return
    count = workers or os.cpu_count() or 1
    while left:
        finished: set[int] = set()
        with _local(count) as executor:
            for one, result in _pass(executor, call, left):
                finished.add(id(one))
                yield one, result
        # work is taken in its order: what was under way when a process died is among the first that is left
        left = [one for one in left if id(one) not in finished]
        suspects, left = left[: 2 * count + 1], left[2 * count + 1 :]
        for one in suspects:
            with _local(1) as executor:
                yield next(_pass(executor, call, [one]), (one, Failed(ENDED)))


def _pass(
    executor: Executor, call: Callable[[Work], Result], work: Sequence[Work]
) -> Iterator[tuple[Work, Result | Failed]]:
    """Yield what one executor completes; nothing of work that was left when a process of it died."""
    futures: dict[Future[Result], Work] = {}
    try:
        for one in work:
            futures[executor.submit(call, one)] = one
    except BrokenProcessPool:
        pass
    try:
        for future in as_completed(futures):
            try:
                result: Result | Failed = future.result()
            except BrokenProcessPool:
                continue
            except InputError as error:
                result = Failed(str(error))
            except Exception as error:
                result = Failed(f"{type(error).__name__}: {summary(error)}")
            yield futures[future], result
    finally:
        for future in futures:
            future.cancel()


@contextmanager
def _local(workers: int) -> Iterator[Executor]:
    """Processes of this machine, each with one thread of linear algebra."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    executor = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name, None) if value is None else os.environ.update({name: value})


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    """The executor of a Dask scheduler."""
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ImportError as error:
        raise InputError(
            "A scheduler needs dask, which is not installed; run: pip install 'hallsym[cluster]'."
        ) from error
    try:
        # asked first, since a client that fails leaves its loop running
        socket.create_connection(get_address_host_port(address), timeout=ANSWERS).close()
        client = Client(address, timeout=ANSWERS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"Scheduler {address} does not answer within {ANSWERS:.0f} s; start it with 'dask scheduler', or "
            "give its address as tcp://HOST:8786."
        ) from error
    try:
        yield client.get_executor(pure=False)
    finally:
        client.close()
