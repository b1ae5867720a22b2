"""The workers of a client, as they are found before any work: what they have, what they agree on, and whether they answer."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from .. import _native
from .._errors import ExecutorError

try:
    import distributed
except ImportError as missing:
    raise ImportError("executor= is for clients of dask.distributed, which is not installed; pip install \"rayset[dask]\"") from missing

from . import worker

T = TypeVar("T")

#: How often a scheduler is asked whether it is there.
_PULSE = 1.0
#: What a worker without a limit may use.
_MEMORY = 1 << 30


class Pool:
    """The workers of a client.

    `look` opens the files on each worker and returns their names; what it raises there is raised here, with the worker's name. `pins` are
    objects that are open here, by their addresses: workers have to find the same there.
    """

    def __init__(self, executor: Any, timeout: float, look: Callable[[], Sequence[str]], pins: Mapping[str, str | None] | None = None) -> None:
        if not isinstance(executor, distributed.Client):
            raise TypeError(f"executor={executor!r}: expected a client of dask.distributed, as in distributed.Client(cluster)")
        if executor.asynchronous:
            raise TypeError("executor: this client is asynchronous; rayset waits for results: distributed.Client(address)")
        self.client = executor
        self.timeout = timeout
        self.is_lost = False
        #: Where the scheduler is, for messages.
        self.where = str(getattr(executor.scheduler, "address", "the scheduler"))
        self.workers = self._asked(look)
        self.fused = self._agreed(pins or {})
        self.threads = sum(one.threads for one in self.workers.values())

    def memory(self, asked: int | None) -> int:
        """What the tasks of a worker may use together: what was asked for, or half of what the smallest worker has."""
        if asked is not None:
            return asked
        limits = [one.memory for one in self.workers.values() if one.memory]
        return min(limits) // 2 if limits else _MEMORY

    def name(self, address: str) -> str:
        """A worker as messages have it."""
        known = self.workers.get(address)
        return address if known is None or known.name in ("", address) else f"{known.name} ({address})"

    def gone(self, what: str) -> ExecutorError:
        """The error of a scheduler that does not answer. It is not asked any more."""
        self.is_lost = True
        return ExecutorError(f"the scheduler at {self.where} {what}; start it again, connect a client, and begin again")

    def unstaffed(self) -> ExecutorError:
        """The error of a scheduler without workers."""
        return ExecutorError(f"the scheduler at {self.where} has had no workers for {self.timeout:g} s (timeout=); start some, and begin again")

    def within(self, what: str, call: Callable[[], T], seconds: float | None = None) -> T:
        """What a call to the scheduler returns, if it does so in time."""
        answer: list[T] = []
        failure: list[BaseException] = []

        def ask() -> None:
            try:
                answer.append(call())
            except BaseException as error:
                failure.append(error)

        thread = threading.Thread(target=ask, name="rayset-ask", daemon=True)
        thread.start()
        # Short, so that Ctrl-C is heard.
        end = time.monotonic() + (self.timeout if seconds is None else seconds)
        while thread.is_alive() and time.monotonic() < end:
            thread.join(0.1)
        if answer:
            return answer[0]
        if failure:
            raise self.gone(f"cannot be asked {what}: {failure[0]}") from failure[0]
        raise self.gone(f"has not answered for {self.timeout:g} s when it was asked {what} (timeout=)")

    def _asked(self, look: Callable[[], Sequence[str]]) -> dict[str, worker.Survey]:
        # A function within another goes there as it is: rayset may be missing.
        def ask(dask_worker: Any) -> Any:
            from rayset._executor import worker

            return worker.survey(look, dask_worker)

        end = time.monotonic() + self.timeout
        found: dict[str, Any] = {}
        while not found:
            found = self.within("what its workers are", lambda: _everywhere(self.client, ask))
            if not found:
                if time.monotonic() >= end:
                    raise self.unstaffed()
                time.sleep(0.2)
        for address, one in found.items():
            if isinstance(one, ImportError):
                own = _native.__version__
                raise ExecutorError(f"worker {address} cannot load rayset: {one}; install rayset {own} where the workers are") from one
            if isinstance(one, BaseException):
                raise ExecutorError(f"worker {address} cannot say what it is: {one}; the version of rayset there may be another than here") from one
        return found

    def _agreed(self, pins: Mapping[str, str | None]) -> bool:
        """Checks that all workers are of one kind, and returns their lowest common class of vector instructions."""
        versions = {self.name(at): one.version for at, one in self.workers.items()}
        self._require_one("versions of rayset", versions | {"this process": _native.__version__})
        systems: dict[str, dict[str, str]] = {}
        for at, one in self.workers.items():
            system, _, build = one.build.rpartition(" ")
            systems.setdefault(system, {})[self.name(at)] = build
        for builds in systems.values():
            self._require_one("builds of rayset", builds)
        for at, one in self.workers.items():
            if one.error is not None:
                raise renamed(one.error, self.name(at))
        self._require_one("files", {self.name(at): tuple(size for _, size, _ in one.files) for at, one in self.workers.items()}, "of these sizes in bytes")
        self._require_one("objects", {self.name(at): tuple(tag for *_, tag in one.files if tag) for at, one in self.workers.items()}, "with these tags")
        for at, one in self.workers.items():
            for name, _, tag in one.files:
                if pins.get(name) not in (None, tag):
                    raise ExecutorError(f"{name} is another object by now than when it was opened here; open it again (worker {self.name(at)})")
        common = frozenset.intersection(*(one.classes for one in self.workers.values()))
        if not common:
            kinds = ", ".join(f"{self.name(at)} {'with' if True in one.classes else 'without'}" for at, one in self.workers.items())
            raise ExecutorError(f"the workers have no class of vector instructions in common ({kinds} fused multiply-add); use machines of one kind")
        # The best that all have.
        return max(common)

    def _require_one(self, what: str, said: dict[str, Any], how: str = "") -> None:
        if len(set(said.values())) > 1:
            each = ", ".join(f"{name}: {value}" for name, value in said.items())
            raise ExecutorError(f"there are different {what}{' ' + how if how else ''} ({each}); all workers need the same")


def _everywhere(client: Any, ask: Callable[..., Any]) -> dict[str, Any]:
    """What all workers answer, errors among it."""
    try:
        answers: dict[str, Any] = client.run(ask, on_error="return")
    except ValueError:
        # There is no worker yet.
        return {}
    return answers


def renamed(error: Exception, name: str) -> Exception:
    """The same error, with the worker's name."""
    return type(error)(f"{error} (worker {name})")


class Pulse:
    """Asks the scheduler now and then whether it is there, and how many workers it has, from a thread of its own."""

    def __init__(self, pool: Pool) -> None:
        self._pool = pool
        self._ended = threading.Event()
        #: When the scheduler last answered, and when it last had workers.
        self._answered = self._staffed = time.monotonic()
        threading.Thread(target=self._ask, name="rayset-pulse", daemon=True).start()

    def _ask(self) -> None:
        client = self._pool.client
        while not self._ended.wait(_PULSE):
            try:
                # As `client.nthreads()`, which would wait for ever for a scheduler that is there and does nothing.
                workers = client.sync(client.scheduler.ncores, callback_timeout=self._pool.timeout)
            except Exception:
                continue
            self._answered = time.monotonic()
            if workers:
                self._staffed = self._answered

    def check(self) -> None:
        """Raises if scheduler or workers have been gone for too long."""
        pool, now = self._pool, time.monotonic()
        if pool.client.status not in ("running", "connecting"):
            raise pool.gone("is gone: the client has lost it")
        if now - self._answered > pool.timeout:
            raise pool.gone(f"has not answered for {pool.timeout:g} s (timeout=)")
        if now - self._staffed > pool.timeout:
            raise pool.unstaffed()

    def end(self) -> None:
        """Ends the thread."""
        self._ended.set()
