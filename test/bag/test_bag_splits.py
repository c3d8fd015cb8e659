"""A bag of several files reads as one, in their order, and what is missing is said."""

import numpy as np
import pytest

from dpc_ros.bag import BagError, read_contents, read_messages, read_raw, read_run


def stamp(k):
    return 5_000_000 * k


def values(message):
    return message.topic, message.log_time_ns, message.publish_time_ns, message.sequence


def test_a_folder_of_several_files_reads_as_one_file(split_bag, record, small_log):
    whole, parts = record(small_log), split_bag(small_log, 12)
    assert [file.name for file in read_contents(parts).files] == [
        f'bag_{k}.mcap' for k in range(12)
    ], 'the order is that of the numbers: 10 after 9'
    one, many = read_run(whole), read_run(parts)
    for name in ('configuration_stamp', 'configuration', 'velocity', 'latent', 'force'):
        np.testing.assert_array_equal(getattr(many, name), getattr(one, name))
    for name in ('messages', 'repeats', 'losses', 'setbacks', 'metadata', 'network_identifier'):
        assert getattr(many, name) == getattr(one, name), name
    assert [values(m) for m in read_messages(parts)] == [values(m) for m in read_messages(whole)]
    assert [(*values(m), m.type_name, m.cdr) for m in read_raw(parts)] == [
        (*values(m), m.type_name, m.cdr) for m in read_raw(whole)
    ]
    contents, expected = read_contents(parts), read_contents(whole)
    assert (contents.start_ns, contents.end_ns) == (expected.start_ns, expected.end_ns)


def test_without_a_table_of_contents_the_numbers_give_the_order(split_bag, small_log):
    folder = split_bag(small_log, 12)
    expected = [values(message) for message in read_raw(folder)]
    (folder / 'metadata.yaml').unlink()
    assert [values(message) for message in read_raw(folder)] == expected
    (folder / 'bag_0.mcap').unlink()  # a recorder may keep the newest files only
    assert read_contents(folder).files[0].name == 'bag_1.mcap'
    (folder / 'bag_5.mcap').unlink()
    with pytest.raises(BagError, match='one is missing between'):
        read_contents(folder)


def test_one_file_of_several_can_be_named(split_bag, small_log):
    folder = split_bag(small_log, 3)
    parts = [values(m) for k in range(3) for m in read_raw(folder / f'bag_{k}.mcap')]
    assert sorted(parts) == sorted(values(m) for m in read_raw(folder))


def test_messages_that_were_split_out_of_order_come_in_the_order_of_their_times(
    split_bag, log_type
):
    # A message that is long on its way is logged in the file after the split.
    log = log_type(configuration=[(stamp(k), [k], [0.0]) for k in range(30)])
    times = [10**18 + 1000 * (k ^ 3) for k in range(30)]
    folder = split_bag(log, 5, times)
    assert [message.log_time_ns for message in read_raw(folder)] == sorted(times)


def test_files_and_table_of_contents_that_do_not_belong_together(split_bag, small_log, tmp_path):
    folder = split_bag(small_log, 3)
    (folder / 'bag_3.mcap').write_bytes((folder / 'bag_2.mcap').read_bytes())
    with pytest.raises(BagError, match=r'there is bag_3\.mcap, too: the recorder did not finish'):
        read_contents(folder)
    (folder / 'bag_3.mcap').rename(folder / 'other.mcap')
    assert len(read_contents(folder).files) == 3, 'what the bag does not name is not of it'
    (folder / 'bag_1.mcap').rename(tmp_path / 'elsewhere.mcap')
    with pytest.raises(BagError, match=r'bag_1\.mcap is missing'):
        read_contents(folder)
    for text in ('{', '', '[1]', 'rosbag2_bagfile_information: {relative_file_paths: [1]}'):
        (folder / 'metadata.yaml').write_text(text)
        with pytest.raises(BagError, match='expected the table of contents of a bag'):
            read_contents(folder)
