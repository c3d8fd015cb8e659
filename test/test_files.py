"""Files and folders are written whole or not at all, and one that can't be written is named."""

import os

import pytest

from dpc_ros.files import new_folder, replacing
from dpc_ros.results import quantity, write_results


def test_a_file_is_replaced_once_it_is_whole(tmp_path):
    path = tmp_path / 'new' / 'folder' / 'file.txt'
    for text in ('first', 'second'):
        with replacing(path) as partial:
            partial.write_text(text)
            assert partial.parent == path.parent
            assert not path.exists() or path.read_text() == 'first'
        assert path.read_text() == text
        assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize('kind', [ValueError, KeyboardInterrupt, SystemExit])
def test_what_is_raised_leaves_the_old_file_and_no_partial_one(tmp_path, kind):
    path = tmp_path / 'file.txt'
    path.write_text('old')

    def write_half():
        with replacing(path) as partial:
            partial.write_text('half')
            raise kind

    with pytest.raises(kind):
        write_half()
    assert path.read_text() == 'old'
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize('place', ['file.txt/below.txt', 'folder', '.', os.devnull, 'x' * 300])
def test_a_place_that_cannot_be_written_is_named(tmp_path, place):
    (tmp_path / 'file.txt').write_text('old')
    (tmp_path / 'folder').mkdir()
    path = tmp_path / place
    with pytest.raises(OSError, match=r"can't be written \(.*\): name another") as caught:
        write_results(path, [])
    assert str(path) in str(caught.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == ['file.txt', 'folder']


@pytest.mark.parametrize('kind', [ValueError, KeyboardInterrupt])
def test_a_folder_is_there_once_it_is_whole(tmp_path, kind):
    path = tmp_path / 'new' / 'folder'

    def write(error=None):
        with new_folder(path) as partial:
            (partial / 'file.txt').write_text('whole')
            assert not path.exists()
            if error is not None:
                raise error

    with pytest.raises(kind):
        write(kind())
    assert list(path.parent.iterdir()) == []
    write()
    assert list(path.parent.iterdir()) == [path]
    with pytest.raises(OSError, match=r"can't be written \(something stands there\)"):
        write()
    assert (path / 'file.txt').read_text() == 'whole'


@pytest.mark.parametrize(
    ('value', 'unit', 'text'),
    [
        (12.34, 's', '12.3 s'),
        (0.01234, 's', '12.3 ms'),
        (0.9996, 's', '1 s'),
        (4.74e-5, 's', '47.4 µs'),
        (3.6e-8, 's', '36 ns'),
        (0.0, 's', '0 ns'),
        (0.123, 'cores', '0.123 cores'),
    ],
)
def test_quantities_are_shown_in_the_unit_that_suits(value, unit, text):
    assert quantity(value, unit) == text
