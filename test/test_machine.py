import pytest

from dpc_ros import machine

CPU = """processor\t: 0
model name\t: Some Processor
model\t\t: 1
flags\t\t: fma avx2

processor\t: 1
model name\t: Some Processor
model\t\t: 1
flags\t\t: fma avx2
"""


@pytest.fixture
def describe(tmp_path, monkeypatch):
    """Return a function: what Linux says of its processors → the description of the machine."""

    def describe(text):
        path = tmp_path / 'cpuinfo'
        path.write_text(text)
        monkeypatch.setattr(machine, '_CPU_INFORMATION', path)
        return machine.describe_machine()

    return describe


def test_the_order_of_features_and_the_number_of_cores_do_not_count(describe):
    first, _, _ = CPU.partition('\n\n')
    assert describe(CPU) == describe(first.replace('fma avx2', 'avx2 fma'))


@pytest.mark.parametrize(
    ('before', 'after'), [('fma avx2', 'fma'), ('model\t\t: 1', 'model\t\t: 2')]
)
def test_processors_of_the_same_name_are_told_apart(describe, before, after):
    assert describe(CPU) != describe(CPU.replace(before, after))
    assert describe(CPU)['processor'].startswith('Some Processor')


def test_another_system_has_a_description_too(monkeypatch, tmp_path):
    monkeypatch.setattr(machine, '_CPU_INFORMATION', tmp_path / 'nowhere')
    assert {'processor', 'system', 'numpy'} <= machine.describe_machine().keys()
