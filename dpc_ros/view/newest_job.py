"""A thread that does what it was asked last."""

from __future__ import annotations

import threading
import traceback
from collections import deque
from collections.abc import Callable

Job = Callable[[], None]


class NewestJob:
    """Does one job after the other in a thread of its own; of those that wait only the newest.

    A drag asks faster than a target is solved for: what came between is of no interest. A job that
    must be done is done in any case.

    Args:
        failed: is called with the reason when a job has raised.
    """

    def __init__(self, failed: Callable[[str], None]) -> None:
        self._failed = failed
        self._condition = threading.Condition()
        self._newest: Job | None = None
        self._musts: deque[Job] = deque()
        self._closed = False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def ask(self, job: Job, must: bool = False) -> None:
        """Do this next, instead of what has not begun and need not be done."""
        with self._condition:
            self._newest = None if must else job
            if must:
                self._musts.append(job)
            self._condition.notify()

    def close(self) -> None:
        """End after the job that is being done."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        self._thread.join()

    def _next(self) -> Job | None:
        """Wait for a job; there is none any more after `close`."""
        with self._condition:
            self._condition.wait_for(lambda: self._closed or self._musts or self._newest)
            if self._closed:
                return None
            if self._musts:
                return self._musts.popleft()
            job, self._newest = self._newest, None
            return job

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                job()
            except Exception as error:  # whatever a target leads to, the next one is welcome
                traceback.print_exc()
                self._failed(f'{type(error).__name__}: {error}')
