"""Solving in a process of its own, so that a loop in real time goes on meanwhile."""

from __future__ import annotations

import multiprocessing
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from dpc_ros.control.solver import MEANWHILE_PERIOD, Answer, Question, Solver

_TRIES = 2  # processes that a question is given to before it is taken for one that ends them
_END_TIMEOUT = 1.0  # s for the process to end by itself


class BackgroundSolver(Solver):
    """Solves in another process, of a lower priority than this one.

    That process makes the law from the same parameters. It sees the end of the connection, and so
    ends when this process does, however it ends. One that ends otherwise is replaced.

    Args:
        parameters: of the controller node, by name.
        meanwhile: is called each second while `wait` waits: to say that it does.

    Raises:
        OSError: the process can't be started.
    """

    is_here = False

    def __init__(
        self, parameters: Mapping[str, Any], meanwhile: Callable[[], None] | None = None
    ) -> None:
        self._parameters = dict(parameters)
        self._meanwhile = meanwhile
        self._question: Question | None = None
        self._tries = 0
        self._start()

    def ask(self, question: Question) -> None:
        self._question, self._tries = question, 0
        self._send()

    def answer(self) -> Answer | None:
        return self._receive() if self._has_come() else None

    def wait(self) -> Answer:
        while True:
            while self._meanwhile is not None and not self._has_come(MEANWHILE_PERIOD):
                self._meanwhile()
            answer = self._receive()
            if answer is not None:
                return answer

    def close(self) -> None:
        self._connection.close()
        try:
            self._process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _start(self) -> None:
        self._connection, theirs = multiprocessing.Pipe()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, '-m', 'dpc_ros.control.solver_process', str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # a Ctrl-C in the terminal is for this process alone
            )
        self._connection.send(self._parameters)

    def _send(self) -> None:
        self._tries += 1
        with suppress(OSError):  # it has just ended, or can't be started: receiving will tell
            if self._process.poll() is not None:
                self.close()
                self._start()
            self._connection.send(self._question)

    def _has_come(self, timeout: float = 0.0) -> bool:
        try:
            return self._connection.poll(timeout)
        except OSError:  # it is closed, as no other process could be started
            return True

    def _receive(self) -> Answer | None:
        """Return the answer; None where the process ended, and another one has the question now."""
        question = self._question
        assert question is not None
        try:
            solution, problem = self._connection.recv()
        except (EOFError, OSError):
            self.close()
            if self._tries < _TRIES:
                self._send()
                return None
            code = self._process.returncode
            return Answer(question, problem=f'the process that solves for it ended with {code}')
        except Exception as error:  # whatever goes wrong in a class that is not ours
            return Answer(question, problem=f'its solution can not be read: {error}')
        return Answer(question, solution, problem)
