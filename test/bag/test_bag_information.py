"""What `info` says of a log is what was written into it."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros import cli
from dpc_ros.bag import BagWriter, QosProfile, read_messages, read_raw
from dpc_ros.bag.fields import fields, stamp_ns
from dpc_ros.bag.header import read_header, starts_with_header
from dpc_ros.bag.information import inform

WRENCH = 'geometry_msgs/msg/WrenchStamped'


def test_a_log_is_shown_with_its_models_records_and_files(split_bag, small_log, capsys):
    frames = ('mass_0@1f3a9c02', 'mass_0')
    log = replace(small_log, network='paper_2@0123456789ab', force_frames=frames)
    folder = split_bag(log, 3)
    cli.main(['bag', 'info', str(folder)])
    shown = capsys.readouterr().out
    information = inform(folder)
    files = sorted(folder.glob('*.mcap'))
    assert information.size == sum(file.stat().st_size for file in files)
    for text in (
        *(f'{file.name}, {file.stat().st_size} bytes' for file in files),
        '/configuration: paper_2@0123456789ab',
        f'/latent_state: {log.checkpoint}',
        'controllers\n  /control_force: mass_0@1f3a9c02\n',
        '  law: energy shaping',
        'geometry_msgs/msg/WrenchStamped',
    ):
        assert text in shown
    for topic, count in information.contents.messages.items():
        assert information.topics[topic].messages == count
    assert information.topics['/configuration'].rate == pytest.approx(1e6)  # 1000 ns apart


@settings(max_examples=25)
@given(
    gaps=st.lists(st.integers(1, 10**9), min_size=1, max_size=20),
    lost=st.data(),
    publishers=st.integers(0, 2),
)
def test_gaps_and_losses(gaps, lost, publishers, messages, tmp_path_factory):
    missing = lost.draw(st.lists(st.integers(0, 3), min_size=len(gaps), max_size=len(gaps)))
    times, numbers = [10**18], [1]
    for gap, miss in zip(gaps, missing, strict=True):
        times.append(times[-1] + gap)
        numbers.append(numbers[-1] + 1 + miss)
    folder = tmp_path_factory.mktemp('gaps') / 'bag'
    with BagWriter(folder) as bag:
        bag.add_topic(messages.topic('/force', WRENCH, (QosProfile(),) * publishers))
        for time, number in zip(times, numbers, strict=True):
            bag.write('/force', messages.wrench(number % 3, (0, 1)), time, time, number)
        bag.count_lost('/force', 5)
    topic = inform(folder).topics['/force']
    assert topic.longest_gap_ns == max(gaps)
    assert topic.rate == pytest.approx(len(gaps) / (sum(gaps) / 1e9))
    assert topic.lost == (None if publishers > 1 else sum(missing))
    assert topic.recorded_lost == 5
    assert topic.repeats == len(times) - len({number % 3 for number in numbers})


def test_the_header_is_read_as_the_decoder_reads_it(small_log, record):
    bag = record(small_log)
    for raw, message in zip(read_raw(bag), read_messages(bag), strict=True):
        header = read_header(raw.cdr)
        assert header.stamp_ns == stamp_ns(message.content)
        assert header.frame_id == fields(message.content)['header.frame_id']


@pytest.mark.parametrize(
    ('definition', 'expected'),
    [
        ('# comment\n\nstd_msgs/Header header # time\nfloat64 x', True),
        ('std_msgs/msg/Header header', True),
        ('Header header\n', True),
        ('float64 x\nstd_msgs/Header header', False),
        ('std_msgs/Header[] headers', False),
        ('', False),
    ],
)
def test_whether_a_message_starts_with_its_header(definition, expected):
    assert starts_with_header(definition) is expected
