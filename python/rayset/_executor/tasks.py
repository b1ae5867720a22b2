"""Tasks that are handed to workers, whose results come as they finish."""

from __future__ import annotations

import contextlib
import queue
import time
import uuid
import weakref
from collections.abc import Callable
from types import TracebackType
from typing import Any

import distributed

from .. import _native
from .._errors import ExecutorError
from . import worker
from .pool import Pool, Pulse, renamed

#: How often a task is tried again whose failure may be the worker's.
_RETRIES = 2
#: How long the tasks of a run that was cancelled may take to see it.
_PATIENCE = 10.0


#: Runs that want to know how far their tasks are, and clients that have been asked to tell.
_runs: weakref.WeakValueDictionary[str, Tasks] = weakref.WeakValueDictionary()
_clients: weakref.WeakSet[Any] = weakref.WeakSet()


def _listen(tasks: Tasks) -> None:
    """Hears what tasks of a run say. A client is asked once, for all runs: the scheduler keeps a log for each topic."""
    _runs[tasks.terms.run] = tasks
    if tasks.pool.client not in _clients:
        tasks.pool.client.subscribe_topic(worker.TOPIC, _hear)
        _clients.add(tasks.pool.client)


def _hear(event: tuple[float, Any]) -> None:
    run, key, done = event[1]
    tasks = _runs.get(run)
    if tasks is not None:
        tasks.said(key, done)


class Tasks:
    """The tasks of one picture or build, as a context: what is left of them at its end is cancelled.

    Workers that die do not matter: the scheduler gives their tasks to others, until a task has taken several workers with it. Tasks of a
    higher `priority` are begun first.
    """

    def __init__(self, pool: Pool, memory: int | None, tells: bool = False) -> None:
        self.pool = pool
        run = uuid.uuid4().hex
        self.terms = worker.Terms(run, _native.__version__, pool.fused, pool.memory(memory), tells)
        #: How much is done of tasks that are under way and have said so.
        self._partly: dict[str, float] = {}
        if tells:
            _listen(self)
        self._futures: dict[Any, tuple[Any, str]] = {}
        self._finished: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._pulse = Pulse(pool)
        self._count = 0

    def submit(self, label: Any, what: str, function: Callable[..., worker.Outcome], *arguments: Any, priority: float = 0) -> None:
        """Hands out a task; `label` comes back with its result, and `what` names it in messages."""
        self._count += 1
        key = f"rayset-{function.__name__}-{self.terms.run}-{self._count}"
        future = self.pool.client.submit(function, self.terms, *arguments, key=key, pure=False, retries=_RETRIES, priority=priority)
        self._futures[future] = (label, what)
        future.add_done_callback(self._finished.put)

    def __len__(self) -> int:
        """How many are under way."""
        return len(self._futures)

    def partly(self) -> float:
        """How many tasks are done of those that are under way, in parts of them."""
        return sum(self._partly.get(future.key, 0.0) for future in self._futures)

    def said(self, key: str, done: float) -> None:
        """A task has said how much of it is done."""
        self._partly[key] = min(max(done, 0.0), 1.0)

    def next(self, waiting: Callable[[], None] | None = None) -> tuple[Any, worker.Outcome]:
        """The next that finishes, with its label. `waiting` is called now and then until there is one."""
        while True:
            try:
                future = self._finished.get(timeout=0.1)
            except queue.Empty:
                self._pulse.check()
                if waiting is not None:
                    waiting()
                continue
            if future not in self._futures:
                continue
            label, what = self._futures[future]
            outcome = self._taken(future, what)
            if outcome is None:
                # It was lost with its worker on the way here, and is made again.
                future.add_done_callback(self._finished.put)
                continue
            del self._futures[future]
            self._partly.pop(future.key, None)
            if outcome.error is not None:
                raise renamed(outcome.error, outcome.worker)
            return label, outcome

    def _taken(self, future: Any, what: str) -> worker.Outcome | None:
        try:
            outcome: worker.Outcome = future.result(timeout=5)
        except (TimeoutError, distributed.TimeoutError):
            self._pulse.check()
            return None
        except distributed.KilledWorker as error:
            raise ExecutorError(
                f"{what} has ended each of several workers that tried it, the last of them {error.last_worker.address}: their memory may be too "
                f"small, which was to be {_megabytes(self.terms.memory)} for all tasks of a worker (memory=), or look into their logs"
            ) from error
        except (distributed.CancelledError, distributed.client.FuturesCancelledError) as error:
            self._settle()
            raise ExecutorError(f"{what} was cancelled: by client.cancel, by a restart, or because all workers are gone; begin again") from error
        except Exception as error:
            self._settle()
            raise ExecutorError(f"{what} failed on {1 + _RETRIES} tries: {type(error).__name__}: {error}") from error
        return outcome

    def _settle(self) -> None:
        """Raises if the scheduler is gone: everything that fails then fails because of it."""
        end = time.monotonic() + 1
        while time.monotonic() < end:
            if self.pool.client.status != "running":
                raise self.pool.gone("is gone: the client has lost it")
            self._pulse.check()
            time.sleep(0.05)

    def __enter__(self) -> Tasks:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        left, self._futures = list(self._futures), {}
        try:
            if left and not self.pool.is_lost and self.pool.client.status == "running":
                # What goes wrong here must not hide why the run ends.
                with contextlib.suppress(ExecutorError):
                    self.pool.within("to cancel tasks", lambda: self.pool.client.cancel(left), _PATIENCE)
                    self._wait_for_workers()
        finally:
            self._pulse.end()

    def _wait_for_workers(self) -> None:
        """Waits until no worker is at a task of this run any more."""
        run, end = self.terms.run, time.monotonic() + _PATIENCE
        while time.monotonic() < end:
            busy = self.pool.within("whether workers have ended", lambda: self.pool.client.run(worker.is_busy, run, on_error="return"), _PATIENCE)
            if not any(one is True for one in busy.values()):
                return
            time.sleep(0.05)


def _megabytes(count: int) -> str:
    return f"{count / (1 << 20):.0f} MiB"
