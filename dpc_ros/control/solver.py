"""Who solves for the targets and parameters of a control law: this process, or another one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from concurrent import futures
from dataclasses import dataclass
from typing import Any

import numpy as np

from dpc_ros.control.law import ControlLaw
from dpc_ros.control.registry import law_of_parameters
from dpc_ros.control.targets import Target
from dpc_ros.reduction import CompressedSystem

MEANWHILE_PERIOD = 1.0  # s


@dataclass(frozen=True, eq=False)
class Question:
    """What is to be solved.

    Attributes:
        parameters: of the law, those in `LAW_PARAMETERS`.
        target: where to go; None where there is no target yet.
    """

    parameters: Mapping[str, Any]
    target: Target | None

    def is_like(self, other: Question) -> bool:
        """Return whether another question has the same answer."""
        if self.parameters != other.parameters or None in (self.target, other.target):
            return self.parameters == other.parameters and self.target is other.target
        assert self.target is not None
        assert other.target is not None
        same_kind = self.target.is_latent == other.target.is_latent
        return same_kind and np.array_equal(self.target.value, other.target.value)


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to a question.

    Attributes:
        question: that was asked.
        solution: for `ControlLaw.adopt`; None where there was no target.
        problem: why there is none; empty where there is.
    """

    question: Question
    solution: Any = None
    problem: str = ''


class Solver(ABC):
    """Answers one question after the other."""

    is_here: bool  # whether it solves in this process, while it is asked for the answer

    @abstractmethod
    def ask(self, question: Question) -> None:
        """Take the next question, after the one before was answered."""

    @abstractmethod
    def answer(self) -> Answer | None:
        """Return the answer to the last question; None where it is not there yet."""

    @abstractmethod
    def wait(self) -> Answer:
        """Return the answer to the last question, however long it takes."""

    def close(self) -> None:  # noqa: B027
        """Let go of everything."""


class SolverHere(Solver):
    """Solves in this process.

    Args:
        system: the compressed system of the law.
        meanwhile: is called each second while it solves: to say that it does.
    """

    is_here = True

    def __init__(
        self, system: CompressedSystem, meanwhile: Callable[[], None] | None = None
    ) -> None:
        self._system = system
        self._meanwhile = meanwhile
        self._question: Question | None = None
        self._law: tuple[Mapping[str, Any], ControlLaw] | None = None  # with its parameters

    def ask(self, question: Question) -> None:
        self._question = question

    def answer(self) -> Answer:
        return self.wait()

    def wait(self) -> Answer:
        if self._meanwhile is None:
            return self._solve()
        with futures.ThreadPoolExecutor(max_workers=1) as thread:
            answer = thread.submit(self._solve)
            while futures.wait([answer], timeout=MEANWHILE_PERIOD).not_done:
                self._meanwhile()
            return answer.result()

    def _solve(self) -> Answer:
        question = self._question
        assert question is not None
        try:
            if self._law is None or self._law[0] != question.parameters:
                law = law_of_parameters(question.parameters, self._system)
                self._law = (question.parameters, law)
            if question.target is None:
                return Answer(question)
            return Answer(question, self._law[1].solve(question.target))
        except Exception as error:  # EquilibriumError, or what a law that is not ours raises
            return Answer(question, problem=str(error) or type(error).__name__)
