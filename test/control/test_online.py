"""What a controller is given while it runs counts from a state on, solved for once."""

from threading import Event

import numpy as np
import pytest

from dpc_ros.control import BackgroundSolver, OnlineController, Target
from dpc_ros.control import solver as solver_module
from dpc_ros.control.online import load_system
from dpc_ros.control.registry import LAW_PARAMETERS, law_of_parameters
from dpc_ros.control.solver import Question, SolverHere
from dpc_ros.parameters import node_parameters
from dpc_ros.threads import single_threaded_algebra

PARAMETERS = node_parameters('controller', {'law': 'paper'})
OF_LAW = {name: PARAMETERS[name] for name in LAW_PARAMETERS}
STEP = 5_000_000  # ns
STATE = np.full(5, 0.3), np.ones(5)
A, B, C = (Target(latent=np.full(5, value)) for value in (0.1, -0.2, 0.4))
NOWHERE = Target(latent=np.zeros(2))


@pytest.fixture(autouse=True)
def as_nodes_do():
    with single_threaded_algebra():
        yield


class Counting(SolverHere):
    """Keeps what it was asked."""

    def __init__(self):
        super().__init__(load_system(PARAMETERS)[2])
        self.asked = []

    def ask(self, question):
        self.asked.append(question)
        super().ask(question)


@pytest.fixture
def solver():
    return Counting()


@pytest.fixture
def controller(solver):
    return OnlineController(PARAMETERS, solver)


def changes(controller, stamp):
    """Return what a stamp brings in force."""
    return [(change.target, bool(change.problem)) for change in controller.bring_in_force(stamp)]


def test_what_was_prepared_is_not_solved_again(controller, solver):
    controller.prepare(A)
    assert not controller.has_target
    again = Target(latent=A.value.copy())
    controller.add_target(0, again)
    assert changes(controller, 0) == [(again, False)]
    assert controller.has_target
    assert len(solver.asked) == 1
    controller.add_target(0, B)
    assert changes(controller, STEP) == [(B, False)]
    assert changes(controller, 2 * STEP) == []
    assert len(solver.asked) == 2


def test_a_bad_target_is_refused_before_it_is_in_force(controller):
    with pytest.raises(ValueError, match='target latent: expected 5 values, got 2'):
        controller.prepare(NOWHERE)


def test_parameters_come_first_and_the_target_in_force_stays(controller, solver):
    controller.add_target(0, A)
    changes(controller, 0)
    before = controller.force(*STATE, 0)
    wanted = {**PARAMETERS, 'proportional_gain': 5.0}
    controller.check(wanted)
    np.testing.assert_array_equal(controller.force(*STATE, 0), before)
    controller.change(wanted)
    controller.add_target(0, B)
    assert changes(controller, STEP) == [(None, False), (B, False)]
    # The check has solved for the new parameters already.
    assert [each.parameters['proportional_gain'] for each in solver.asked] == [2.0, 5.0, 5.0]
    assert controller.parameters == controller.wanted == {**OF_LAW, 'proportional_gain': 5.0}
    fresh = OnlineController(wanted)
    fresh.law.regulate(B)
    np.testing.assert_array_equal(controller.force(*STATE, STEP), fresh.law.force(*STATE))


def test_what_can_not_be_solved_leaves_all_as_it_was(controller):
    controller.add_target(0, A)
    changes(controller, 0)
    before = controller.force(*STATE, 0)
    with pytest.raises(ValueError, match='unknown control law'):
        controller.check({**PARAMETERS, 'law': 'pid'})
    controller.change({**PARAMETERS, 'law': 'pid'})
    assert changes(controller, STEP) == [(None, True)]
    assert controller.parameters == controller.wanted == OF_LAW
    controller.add_target(0, NOWHERE)
    assert changes(controller, 2 * STEP) == [(NOWHERE, True)]
    assert changes(controller, 3 * STEP) == []
    np.testing.assert_array_equal(controller.force(*STATE, 3 * STEP), before)
    # Other parameters may make it possible: it is tried again.
    controller.change({**PARAMETERS, 'derivative_gain': 3.0})
    assert changes(controller, 4 * STEP) == [(None, False), (NOWHERE, True)]


def test_another_gain_does_not_forget_what_was_integrated():
    parameters = {'law': 'lqr', 'integral_gain': 2.0, 'integral_delay': 0.0}
    controller = OnlineController(node_parameters('controller', parameters))
    controller.add_target(0, A)
    changes(controller, 0)
    near = A.value + 0.01, np.zeros(5)  # so near that the force is not saturated
    first = controller.force(*near, 0)
    for k in range(1, 20):
        last = controller.force(*near, k * STEP)
    assert np.linalg.norm(last - first) > 0
    integrated = controller.law._constant
    controller.change(node_parameters('controller', {**parameters, 'integral_gain': 1.0}))
    assert changes(controller, 20 * STEP) == [(None, False)]
    np.testing.assert_allclose(controller.law._constant, integrated, rtol=0, atol=1e-12)


def test_a_question_that_ends_every_process_is_given_up(monkeypatch):
    background = BackgroundSolver(PARAMETERS)
    try:
        background.ask(Question(OF_LAW, A))
        assert not background.wait().problem
        for parameters in ({'network': 'none'}, PARAMETERS):  # as if the next could not be started
            monkeypatch.setattr(background, '_parameters', parameters)
            background._process.kill()
            background._process.wait()
            background.ask(Question(OF_LAW, A))
            answer = background.wait()
            assert ('ended with 1' in answer.problem) == (parameters is not PARAMETERS)
    finally:
        background.close()


def test_another_process_gives_the_same_bits(solver):
    parameters = {**OF_LAW, 'law': 'lqr'}
    background = BackgroundSolver(PARAMETERS)
    try:
        for target in (B, NOWHERE, C):
            question = Question(parameters, target)
            background.ask(question)
            solver.ask(question)
            there, here = background.wait(), solver.wait()
            assert there.problem == here.problem
            assert bool(here.problem) == (target is NOWHERE)
            if target is not NOWHERE:
                for name, value in vars(here.solution).items():
                    np.testing.assert_array_equal(getattr(there.solution, name), value)
    finally:
        background.close()


def test_who_waits_for_an_answer_here_can_say_so_meanwhile(monkeypatch):
    monkeypatch.setattr(solver_module, 'MEANWHILE_PERIOD', 0.001)
    looked = Event()

    def solve(law, target):
        assert looked.wait(60)
        return 'solved'

    system = load_system(PARAMETERS)[2]
    law = law_of_parameters(OF_LAW, system)
    monkeypatch.setattr(type(law), 'solve', solve)
    solver = SolverHere(system, looked.set)
    solver.ask(Question(OF_LAW, A))
    assert solver.wait().solution == 'solved'
