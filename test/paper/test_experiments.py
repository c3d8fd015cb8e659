"""The experiments measure what they say, and the page and its figures follow from the results."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.autoencoder.recipe import Recipe, load_recipe
from dpc_ros.autoencoder.training import reconstruction_mse
from dpc_ros.data import simulate_conditions
from dpc_ros.data.conditions import test_conditions as held_out_conditions
from dpc_ros.network import load_network, save_network
from dpc_ros.paper import (
    commands,
    compression,
    mse_table,
    noise,
    over_time,
    pointwise,
    reduced,
    systems,
    tables,
)
from dpc_ros.paper.models import Workshop, in_batches, parameters
from dpc_ros.paper.published import best_test_mse, published_mse
from dpc_ros.paper.recipes import EXTENDED, FLAT, GRAPH, OURS, POD, SYSTEMS, Model
from dpc_ros.resources import config_path, share_directory

DOCS = share_directory() / 'docs'
MODELS = {'flat': FLAT, 'graph': GRAPH, 'pod': POD, 'ours': OURS, 'extended': EXTENDED}
SHIPPED = sorted(path.stem for path in config_path('checkpoints').glob('*.json'))


def rows_of(name):
    return json.loads((DOCS / 'results' / f'{name}.json').read_text())['rows']


@pytest.fixture(scope='module')
def workshop(tmp_path_factory):
    folder = tmp_path_factory.mktemp('paper')
    return Workshop(folder / 'data', folder / 'training', DOCS / 'results', progress=False)


@pytest.fixture(scope='module')
def body(tmp_path_factory, small_network):
    path = tmp_path_factory.mktemp('network') / 'grid.json'
    save_network(small_network, path)
    return str(path)


def small_model(body):
    """A model of two candidates, of which the second is hardly trained at all."""
    recipe = Recipe('first', body, latent_size=2, hidden_sizes=(8,), epochs=3, skip=True)
    worse = replace(recipe, name='second', skip=False, epochs=1, learning_rate=0.0)
    return Model('ours', 'best', 'paper', lambda system, m: [worse, recipe])


def test_no_two_trainings_share_a_name():
    names = [
        recipe.name
        for model in MODELS.values()
        for system in SYSTEMS
        for m in range(1, 9)
        for recipe in model.candidates(system, m)
    ]
    assert len(set(names)) == len(names)


def test_the_best_by_validation_is_taken(workshop, body):
    trained = workshop.trained(small_model(body), body, 2)
    assert trained.checkpoint.name == 'first'
    scores = trained.checkpoint.provenance['scores']
    worse = load_checkpoint(workshop.training / 'second.json').provenance['scores']
    assert scores['validation_mse'] < worse['validation_mse']
    test = workshop.dataset(body).test
    assert reconstruction_mse(trained.autoencoder(), test) == pytest.approx(scores['test_mse'])


def test_what_is_trained_is_not_trained_again(workshop, body):
    model = small_model(body)
    path = workshop.training / 'first.json'
    workshop.trained(model, body, 2)
    before = path.stat().st_mtime_ns
    workshop.trained(model, body, 2)
    assert path.stat().st_mtime_ns == before
    other = replace(model.candidates(body, 2)[1], seed=9)
    with pytest.raises(ValueError, match='trained by another recipe'):
        workshop.trained(replace(model, candidates=lambda system, m: [other]), body, 2)


def test_the_projection_is_never_worse_on_average(workshop, body):
    trained = workshop.trained(small_model(body), body, 2)
    test = workshop.dataset(body).test[::50]
    network, projection = (
        reconstruction_mse(trained.autoencoder(encoder), test)
        for encoder in ('network', 'projection')
    )
    assert projection <= network


def test_errors_of_the_pointwise_experiment_vanish_on_the_manifold(workshop, body, mechanics):
    autoencoder = load_checkpoint('paper_2_pod_m5').autoencoder()
    rng = np.random.default_rng(0)
    latent, velocity = rng.normal(size=(2, 5))
    q, jacobian = autoencoder.decode_with_jacobian(latent)
    errors = pointwise.state_errors(mechanics, autoencoder, q, jacobian @ velocity)
    np.testing.assert_allclose(errors, 0, atol=1e-12)


@pytest.fixture
def small_reduced(body, monkeypatch):
    """The experiment on the small body, with two small models and its first test simulations."""
    linear = Recipe('linear', body, kind='pod', latent_size=2)
    pod = Model('pod', 'paper', 'paper', lambda system, m: [linear])
    conditions = held_out_conditions()[:5]
    monkeypatch.setattr(reduced, 'test_conditions', lambda: conditions)
    monkeypatch.setattr(reduced, '_MODELS', ((pod, 'network'), (small_model(body), 'projection')))
    monkeypatch.setattr(reduced, 'LATENT_SIZE', 2)
    monkeypatch.setattr(reduced, '_SHOWN_SYSTEM', body)
    monkeypatch.setattr(reduced, '_SHOWN', {'flat': pod})
    monkeypatch.setattr(reduced, '_ANIMATED', ())
    monkeypatch.setattr(reduced, 'animate', lambda *arguments, **options: None)
    return reduced


@pytest.mark.long
def test_models_are_compared_as_compressed_systems(workshop, body, small_reduced, tmp_path):
    rows = small_reduced.measure(workshop, (body,))
    assert [row['model'] for row in rows['reduced']] == ['pod', 'ours']
    for row in rows['reduced']:
        assert (row['simulations'], row['diverged']) == (5, 0)
        assert 0 < row['relative_error_median'] <= row['relative_error_max']
        assert row['relative_error_median'] < row['relative_error_about_rest_median']
        assert row['stable_step_s'] in reduced.STEPS
        assert row['energy_increase_max'] < 1e-9
    times = sorted({row['time_s'] for row in rows['reduced_time']})
    np.testing.assert_allclose(times, np.arange(101) * 0.05)
    assert len(rows['reduced_time']) == 2 * len(times)
    drawn = {path.name for path in small_reduced.draw(workshop, rows, tmp_path)}
    assert {path.name for path in tmp_path.iterdir()} == drawn - {'reduced.gif'}


@pytest.fixture
def held_out(small_network):
    return list(simulate_conditions(small_network, held_out_conditions()[:3]))


def test_the_stable_step_is_the_longest_without_a_rise(small_network, small_autoencoder, held_out):
    autoencoder = small_autoencoder(3)
    longest = reduced.stable_step(small_network, autoencoder, held_out)
    for step in reduced.STEPS:
        each = [reduced.compared(small_network, autoencoder, step, *one) for one in held_out]
        stable = all(one is not None and one.energy_increase < 0.01 for one in each)
        assert stable == (step <= longest)
    stiff = replace(small_network, stiffness=1e4 * small_network.stiffness)
    assert np.isnan(reduced.stable_step(stiff, autoencoder, held_out))


def test_diverged_simulations_count_as_infinite_errors(small_network, small_autoencoder, held_out):
    whole = [
        reduced.compared(small_network, small_autoencoder(3), 0.01, *each) for each in held_out
    ]
    errors = [each.relative_error for each in whole]
    one = reduced.summary([8, 9, 10], [whole[0], None, whole[2]])
    assert one['diverged'] == 1
    assert one['relative_error_median'] == max(errors[0], errors[2])
    assert np.isnan(one['relative_error_max'])
    assert one['relative_error_max_simulation'] == 9
    most = reduced.summary([8, 9, 10], [None, whole[1], None])
    assert np.isnan(most['relative_error_median'])
    over_time_of_two = reduced.errors_over_time([whole[0], None, whole[2]])
    assert {row['simulations'] for row in over_time_of_two} == {2}
    last = [whole[k].configuration_error[-1] for k in (0, 2)]
    assert over_time_of_two[-1]['configuration_median'] == pytest.approx(np.mean(last))
    assert reduced.errors_over_time([None]) == []


def test_batches_are_consecutive_and_whole():
    frames = np.arange(10)
    np.testing.assert_array_equal(np.concatenate(list(in_batches(frames, 4))), frames)
    assert [len(batch) for batch in in_batches(frames, 4)] == [4, 4, 2]


@pytest.mark.parametrize('name', SHIPPED)
def test_shipped_checkpoints_are_those_of_the_experiments(name):
    checkpoint = load_checkpoint(name)
    system, model, size = name.rsplit('_', 2)
    checkpoint.check_network(load_network(system))
    (recipe,) = MODELS[model].candidates(system, int(size.removeprefix('m')))
    assert Recipe(**checkpoint.provenance['recipe']) == recipe


@pytest.mark.parametrize(
    'name', sorted(path.stem for path in config_path('training').glob('*.yaml'))
)
def test_shipped_recipes_are_those_of_the_experiments(name):
    system, model, size = name.rsplit('_', 2)
    (recipe,) = MODELS[model].candidates(system, int(size.removeprefix('m')))
    assert load_recipe(name) == recipe


def test_ours_is_smaller_than_the_papers_flat_model():
    ours, flat = (load_checkpoint(f'paper_2_{name}') for name in ('extended_m5', 'flat_m2'))
    assert parameters(ours) < parameters(flat) / 3
    assert parameters(load_checkpoint('paper_2_graph_m5')) == 54217
    assert parameters(load_checkpoint('paper_2_pod_m5')) == 5 * 400


def test_published_values_are_found():
    assert published_mse('paper_4', 'graph', 5) == 9.71e-4
    assert published_mse('paper_4', 'ours', 5) is None
    for system in SYSTEMS:
        for size in (2, 3, 4, 5):
            values = [published_mse(system, model, size) for model in ('flat', 'graph')]
            assert best_test_mse(system, size) == min(values)
    assert best_test_mse('paper_1', 8) is None


@pytest.mark.parametrize('name', tables.PAGES)
def test_tables_of_the_pages_are_those_of_the_results(name):
    page = (DOCS / name).read_text()
    assert '<!-- table' in page
    assert tables.with_tables(page, DOCS / 'results') == page


def test_pages_are_written_whole_or_not_at_all(tmp_path):
    docs = tmp_path / 'docs'
    (docs / 'results').mkdir(parents=True)
    mark = '<!-- table systems from systems -->\n<!-- end -->\n'
    first, *_, last = tables.PAGES
    for name in tables.PAGES:
        (docs / name).write_text(mark.replace('m sys', 'm no') if name == last else mark)
    shutil.copy(DOCS / 'results' / 'systems.json', docs / 'results')
    with pytest.raises(FileNotFoundError):
        tables.write_tables(docs)
    assert (docs / first).read_text() == mark
    (docs / last).write_text(mark)
    assert len(tables.write_tables(docs)) == len(tables.PAGES)
    for name in tables.PAGES:
        assert '| system |' in (docs / name).read_text()


def test_a_page_that_asks_for_an_unknown_table_is_refused():
    page = '<!-- table nothing from systems -->\n<!-- end -->'
    with pytest.raises(ValueError, match="no table 'nothing'"):
        tables.with_tables(page, DOCS / 'results')


@pytest.mark.parametrize(
    ('name', 'module'),
    [
        ('mse_table', mse_table),
        ('compression', compression),
        ('noise', noise),
        ('pointwise', over_time),
        ('reduced_time', over_time),
        ('systems', systems),
    ],
)
def test_figures_are_drawn_from_the_results(tmp_path, name, module):
    path = tmp_path / 'figure.png'
    module.draw(rows_of(name), path)
    assert path.read_bytes().startswith(b'\x89PNG')


def test_unknown_experiments_are_refused(workshop, tmp_path):
    with pytest.raises(ValueError, match="no experiment 'nothing'"):
        commands.run('nothing', workshop, tmp_path)


def test_the_command_names_every_experiment():
    from dpc_ros.cli import PAPER_EXPERIMENTS

    assert commands.NAMES == PAPER_EXPERIMENTS
