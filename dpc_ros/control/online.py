"""The controller without ROS: what it keeps between messages.

Its node is an adapter around this; a log that is run again is fed to the very same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from dpc_ros.autoencoder import Checkpoint
from dpc_ros.control.law import ControlLaw
from dpc_ros.control.models import load_models
from dpc_ros.control.registry import LAW_PARAMETERS, law_of_parameters
from dpc_ros.control.schedule import TargetSchedule
from dpc_ros.control.solver import Answer, Question, Solver, SolverHere
from dpc_ros.control.targets import Target
from dpc_ros.finite import all_finite
from dpc_ros.network import Gravity, MassSpringNetwork, Mechanics
from dpc_ros.reduction import CompressedSystem


@dataclass(frozen=True)
class Change:
    """Something new that a controller has brought in force, or why it could not.

    Attributes:
        target: which it is, or None where it is the law's parameters.
        problem: why the law in force stays as it was; empty where it is the new one.
    """

    target: Target | None = None
    problem: str = ''


class OnlineController:
    """A control law, with the targets and the parameters that it is given while it runs.

    What is new is solved for, and counts from a stamp on: parameters first, for the target in
    force; then the newest target that is due, for the parameters in force. Where another process
    solves, the law in force goes on meanwhile; of what comes meanwhile only the newest is solved.

    Args:
        parameters: of the controller node, by name.
        solver: who solves; this process where left out.
        meanwhile: is called each second while this process solves, where no solver is given.

    Attributes:
        law: the control law in force.
        parameters: those in force, of `LAW_PARAMETERS`.
        wanted: those that are to be, as soon as they are solved for; the same where none are.

    Raises:
        FileNotFoundError: there is no such network or checkpoint.
        ValueError: a parameter, or a checkpoint of another network.
    """

    def __init__(
        self,
        parameters: Mapping[str, Any],
        solver: Solver | None = None,
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        self.network, self.checkpoint, self._system = load_system(parameters)
        self.parameters: Mapping[str, Any] = _of_law(parameters)
        self.wanted: Mapping[str, Any] = self.parameters
        self.law: ControlLaw = law_of_parameters(self.parameters, self._system)
        self._solver = solver or SolverHere(self._system, meanwhile)
        self._schedule = TargetSchedule()
        self._target: Target | None = None  # of the law in force
        self._seen: Target | None = None  # that has been asked for last
        self._question: Question | None = None  # that is being solved
        self._known: Answer | None = None  # the last one that was solved

    @property
    def has_target(self) -> bool:
        """Whether the law has ever had a target that it can use."""
        return self._target is not None

    def add_target(self, stamp: int, target: Target) -> None:
        """Take a target that counts from a stamp [ns] on; zero means at once."""
        self._schedule.add(stamp, target)

    def prepare(self, target: Target) -> None:
        """Solve for a target before it is in force, and warm up; blocks until that is done.

        Raises:
            ValueError: the law can't use the target.
        """
        self._solve_now(Question(self.wanted, target))

    def warm_up(self) -> None:
        """Compile what compiles at its first call; block until the solver is ready.

        Raises:
            ValueError: the solver can't be started.
        """
        self._solve_now(Question(self.wanted, None))
        with suppress(ValueError):  # which targets are possible is no matter here
            self.prepare(Target(configuration=self.network.rest_configuration))

    def check(self, parameters: Mapping[str, Any]) -> None:
        """Make sure that the law of other parameters can be made.

        A solver in this process solves for the target in force, too. Another process takes its
        time: what it finds, `bring_in_force` tells.

        Raises:
            ValueError: it can't.
        """
        wanted = _of_law(parameters)
        if wanted == self.wanted:
            return
        law_of_parameters(wanted, self._system)
        if self._solver.is_here:
            self._solve_now(Question(wanted, self._target))

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Take other parameters, which count as soon as they are solved for."""
        self.wanted = _of_law(parameters)

    def restart(self) -> None:
        """Begin anew with a law that keeps nothing of before."""
        self.law.restart()

    def begin_epoch(self) -> None:
        """Begin anew where stamps do; the target in force stays so."""
        self._schedule.restart()
        self.restart()

    def bring_in_force(self, stamp: int) -> list[Change]:
        """Let the law of a stamp [ns] be the one of what is due and solved; return what is new."""
        changes: list[Change] = []
        while True:
            if self._question is None:
                self._question = self._due(stamp)
                if self._question is None:
                    return changes
                if not self._known_answer(self._question):
                    self._solver.ask(self._question)
            answer = self._known_answer(self._question) or self._solver.answer()
            if answer is None:
                return changes
            self._question = None
            changes.append(self._adopt(answer))

    def _due(self, stamp: int) -> Question | None:
        """Return what is to be solved next, if there is anything."""
        if self.wanted != self.parameters:
            return Question(self.wanted, self._target)
        target = self._schedule.in_force(stamp)
        if target is None or target is self._seen:
            return None
        self._seen = target
        return Question(self.parameters, target)

    def _adopt(self, answer: Answer) -> Change:
        question, problem = answer.question, answer.problem
        is_target = question.parameters == self.parameters
        if not problem:
            try:
                self._adopt_target(answer) if is_target else self._adopt_parameters(answer)
                self._known = answer
            except Exception as error:  # whatever goes wrong in a law that is not ours
                problem = str(error)
        if problem and self.wanted == question.parameters:
            self.wanted = self.parameters
        return Change(question.target if is_target else None, problem)

    def _adopt_target(self, answer: Answer) -> None:
        self.law.adopt(answer.solution)
        self._target = answer.question.target

    def _adopt_parameters(self, answer: Answer) -> None:
        law = law_of_parameters(answer.question.parameters, self._system)
        if answer.question.target is not None:
            law.adopt(answer.solution)
        law.carry_on(self.law)
        self.law, self.parameters = law, answer.question.parameters
        self._seen = self._target  # one that could not be used may be possible now

    def _known_answer(self, question: Question) -> Answer | None:
        if self._known is None or not question.is_like(self._known.question):
            return None
        return replace(self._known, question=question)

    def _solve_now(self, question: Question) -> None:
        if self._known_answer(question):
            return
        self._solver.ask(question)
        answer = self._solver.wait()
        if answer.problem:
            raise ValueError(answer.problem)
        self._known = answer

    def force(
        self,
        latent: Float[np.ndarray, ' m'],
        latent_velocity: Float[np.ndarray, ' m'],
        stamp: int,
    ) -> Float[np.ndarray, ' 2']:
        """Return u [N] for the next latent state.

        Raises:
            ValueError: the law gives no finite force in the plane.
            Exception: whatever else a law of another package raises.
        """
        force = self.law.force(latent, latent_velocity, stamp)
        if not (force.shape == (2,) and all_finite(force)):
            raise ValueError(f'expected a finite force in the plane, got {force}')
        return force


def load_system(
    parameters: Mapping[str, Any],
) -> tuple[MassSpringNetwork, Checkpoint, CompressedSystem]:
    """Return network, checkpoint and compressed system that a controller's parameters name.

    Raises:
        FileNotFoundError: there is no such network or checkpoint.
        ValueError: a parameter, or a checkpoint of another network.
    """
    network, checkpoint, autoencoder = load_models(parameters)
    gravity = Gravity(parameters['gravity_magnitude'], parameters['gravity_angle'])
    mechanics = Mechanics(network, gravity)
    return (
        network,
        checkpoint,
        CompressedSystem(mechanics, autoencoder, parameters['actuated_mass']),
    )


def _of_law(parameters: Mapping[str, Any]) -> dict[str, Any]:
    return {name: parameters[name] for name in LAW_PARAMETERS}
