"""A recorder that is killed leaves a log that can be mended."""

import pytest

from dpc_ros.bag import BagError, read_run
from dpc_ros.bag.repair import repair
from dpc_ros.nodes.launch_plan import LOOP

ENOUGH = 200_000  # bytes in the log when the recorder is killed: many chunks
CHUNK_SIZE = 16_384  # bytes


@pytest.mark.faults(
    fault='recorder killed (`kill -9`)',
    promise='`dpc bag repair` saves every complete chunk',
    mode='both',
    most=10,
)
def test_a_log_whose_recorder_was_killed_is_mended(domain, observer, plan, tmp_path, reference):
    made = plan(recorder={'chunk_size': CHUNK_SIZE}, simulator={'duration': 600.0})
    recorder = domain.start_node('recorder', made)
    observer.wait_for_node('recorder')
    loop = [domain.start_node(kind, made) for kind in LOOP]
    file = made.bag / f'{made.bag.name}_0.mcap'
    observer.wait(lambda: file.exists() and file.stat().st_size > ENOUGH, 'a log of many chunks')
    for process in (recorder, *loop):
        domain.kill(process)
    assert not (made.bag / 'metadata.yaml').exists()
    with pytest.raises(BagError, match='dpc bag repair'):
        read_run(made.bag)
    repaired, table = repair(made.bag, tmp_path / 'mended')
    assert repaired.losses
    assert table.name == 'metadata.yaml'
    run = read_run(tmp_path / 'mended')
    # What was written is what happened: the first frames of the same run in one process.
    count = len(run.configuration)
    assert count > 0
    assert run.configuration_stamp.tolist() == [5_000_000 * k for k in range(count)]
    compared = min(count, len(reference.configuration))
    assert (run.configuration[:compared] == reference.configuration[:compared]).all()
    assert not any(run.losses.values())
    size = len(run.configuration) * 2 * run.configuration.shape[1] * run.configuration.itemsize
    assert size > ENOUGH / 2, 'most of what was written is there'
