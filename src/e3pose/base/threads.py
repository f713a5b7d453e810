"""Threads that end together when one fails, bounded calls on one, and work shared by several."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from e3pose.base.errors import Fault

MOST = 15  # characters that Linux keeps
Item = TypeVar("Item")
Found = TypeVar("Found")


def show_thread_name() -> None:
    """Give the running thread the name that it has in Python; does nothing beside Linux."""
    thread = threading.current_thread()
    try:
        # Opened to be changed, not made: elsewhere there is no such file.
        with Path(f"/proc/self/task/{thread.native_id}/comm").open("r+", encoding="utf-8") as file:
            file.write(thread.name[:MOST])
    except OSError:
        return


class ThreadGroup:
    """Threads that run until stopped."""

    def __init__(self, wake: Callable[[], Any]) -> None:
        """Start without threads.

        Args:
            wake: called when all must end, to wake threads that wait.
        """
        self.stopping = threading.Event()
        self.failure: BaseException | None = None
        self._wake = wake
        self._threads: dict[str, threading.Thread] = {}

    def start(self, name: str, body: Callable[[], Any]) -> None:
        """Start a thread."""
        thread = threading.Thread(target=self._guarded, args=(body,), name=name, daemon=True)
        self._threads[name] = thread
        thread.start()

    def running(self) -> bool:
        """Return whether all are still running."""
        return self.failure is None and not self.stopping.is_set()

    def check(self) -> None:
        """Raise `Fault` if one has failed."""
        if self.failure is not None:
            raise Fault(str(self.failure)) from self.failure

    def fail(self, error: BaseException) -> None:
        """End all because of an error: the program must end with it, not go on half."""
        self.failure = error
        self.stopping.set()
        self._wake()

    def stop(self) -> bool:
        """Ask all to end; return False if they were already asked."""
        first = not self.stopping.is_set()
        self.stopping.set()
        return first

    def alive(self, name: str) -> bool:
        """Return whether a thread has not ended."""
        return name in self._threads and self._threads[name].is_alive()

    def join(self, timeout_s: float, without: str = "") -> None:
        """Wait until all but one have ended, at most so long for each."""
        for name, thread in list(self._threads.items()):  # one may be started anew meanwhile
            if name != without:
                thread.join(timeout=timeout_s)

    def _guarded(self, body: Callable[[], Any]) -> None:
        show_thread_name()
        try:
            body()
        except BaseException as error:
            self.fail(error)


class OtherThread:
    """Calls functions on a thread of its own, which is left behind when one takes too long.

    Nothing ends a library that looks at no clock, but who waits for it can go on.

    Attributes:
        at_work: whether a call has not come back: nobody may touch what it works on.
    """

    def __init__(self) -> None:
        """Start the thread."""
        self.at_work = False
        self._calls: SimpleQueue[Callable[[], Any] | None] = SimpleQueue()
        self._answers: SimpleQueue[tuple[Any, BaseException | None]] = SimpleQueue()
        threading.Thread(target=self._run, name="apart", daemon=True).start()

    def call(self, function: Callable[[], Found], limit_s: float) -> Found:
        """Call a function; return its result or raise its error.

        Raises:
            TimeoutError: when it takes more than `limit_s`.
        """
        self.at_work = True
        self._calls.put(function)
        try:
            found, error = self._answers.get(timeout=limit_s)
        except Empty:
            raise TimeoutError from None
        self.at_work = False
        if error is not None:
            raise error
        return found  # type: ignore[no-any-return]

    def end(self) -> None:
        """Let the thread end."""
        self._calls.put(None)

    def _run(self) -> None:
        for function in iter(self._calls.get, None):
            try:
                self._answers.put((function(), None))
            except BaseException as error:
                self._answers.put((None, error))


def in_order(
    function: Callable[[Item], Found], items: Iterable[Item], threads: int
) -> Iterator[Found]:
    """Yield what a function makes of each item, in their order, on so many threads at once.

    Items are taken as they are needed: at most two for each thread wait for their turn. With one
    thread there is no other, and an item is taken when the one before is done.
    """
    if threads == 1:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[Found]] = deque()
        try:
            for item in items:
                waiting.append(pool.submit(function, item))
                while waiting and (len(waiting) > 2 * threads or waiting[0].done()):
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:  # nobody waits for the others
            for each in waiting:
                each.cancel()
