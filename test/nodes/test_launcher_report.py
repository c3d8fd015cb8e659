"""What the launcher shows of a run that went to its end."""

import shutil

import pytest

from dpc_ros.nodes.launch_plan import make_plan
from dpc_ros.nodes.launcher import Outcome, report
from dpc_ros.resources import config_path, share_directory


@pytest.fixture
def plan(tmp_path):
    """A plan whose log is there already: the sample."""
    plan = make_plan(config_path('demo.yaml'), {}, tmp_path / 'run', '/', True, 0, 0.0)
    shutil.copytree(share_directory() / 'bags' / 'demo_1s', plan.bag)
    return plan


def test_the_address_of_the_page_comes_first(plan, capsys):
    assert report(plan, Outcome(bags=[plan.bag])) == 0
    first, *others = capsys.readouterr().out.splitlines()
    page = plan.folder / 'report.html'
    assert first == f'report      {page.resolve().as_uri()}'
    assert page.is_file()
    assert any(line.startswith('final nMSE') for line in others)
    assert f'figure      {plan.folder / "convergence.png"}' in others


def test_a_page_that_can_not_be_written_takes_not_the_table(plan, capsys):
    (plan.folder / 'report.html').mkdir()
    assert report(plan, Outcome(bags=[plan.bag])) == 1
    shown = capsys.readouterr()
    assert 'final nMSE' in shown.out
    assert 'report ' not in shown.out
    assert shown.err.startswith(f"error: {plan.folder / 'report.html'} can't be written")
