"""Training lowers the error, can be cut off anywhere, and looks at nothing it should not."""

from dataclasses import replace

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.torch import save_file

from dpc_ros.autoencoder import experiment as experiment_module
from dpc_ros.autoencoder import load_checkpoint, training
from dpc_ros.autoencoder.experiment import state_path, train_checkpoint
from dpc_ros.autoencoder.recipe import Recipe
from dpc_ros.autoencoder.training import reconstruction_mse, train
from dpc_ros.data import Condition, make_dataset, save_dataset
from dpc_ros.network import Gravity, save_network

RECIPE = Recipe(
    'grid_m2',
    'grid',
    latent_size=2,
    hidden_sizes=(16, 8),
    activation='silu',
    skip=True,
    epochs=9,
    batch_size=64,
    schedule='one_cycle',
)
PLAIN = replace(RECIPE, name='plain', skip=False, activation='elu', schedule='step', seed=4)
POD = replace(RECIPE, name='pod_coordinates', pod_size=6, optimizer='adamw', weight_decay=0.01)
GRAPH = replace(RECIPE, name='graph', kind='graph', channels=6, convolutions=2, node_features=3)
NOISY = replace(RECIPE, name='noisy', input_noise=0.02)
RECIPES = [RECIPE, PLAIN, POD, GRAPH, NOISY]


@pytest.fixture
def saved_every_two_epochs(monkeypatch):
    monkeypatch.setattr(training, 'SAVE_INTERVAL', 2)


def cut_off(monkeypatch, recipe, small_network, dataset, path, epoch):
    """Train until the second batch of an epoch, and be killed there."""
    steps_per_epoch = -(-len(dataset.train) // recipe.batch_size)
    assert steps_per_epoch > 1
    rate = Recipe.learning_rate_at

    def rate_or_death(self, step, steps):
        if step == epoch * steps_per_epoch + 1:
            raise KeyboardInterrupt
        return rate(self, step, steps)

    with monkeypatch.context() as patch:
        patch.setattr(Recipe, 'learning_rate_at', rate_or_death)
        with pytest.raises(KeyboardInterrupt):
            train(recipe, small_network, dataset, path)


def epoch_of(path):
    with safe_open(str(path), framework='pt') as file:
        return int(file.metadata()['epoch'])


def assert_same_bits(first, second):
    first, second = first.tensors(), second.tensors()
    assert first.keys() == second.keys()
    for name in first:
        assert first[name].tobytes() == second[name].tobytes(), name


@pytest.mark.parametrize('recipe', RECIPES, ids=lambda recipe: recipe.name)
def test_training_lowers_the_error(recipe, dataset, small_network):
    short = train(replace(recipe, epochs=1, learning_rate=0.0), small_network, dataset).export()
    long = train(replace(recipe, epochs=40), small_network, dataset).export()
    before = reconstruction_mse(short, dataset.validation)
    assert reconstruction_mse(long, dataset.validation) < 0.9 * before


@pytest.mark.parametrize('recipe', [RECIPE, POD], ids=lambda recipe: recipe.name)
def test_noise_on_the_input_teaches_the_encoder_to_reject_it(recipe, dataset, small_network):
    noise = 0.1  # m, of the order of the body's motion
    recipe = replace(recipe, epochs=60)
    disturbance = np.random.default_rng(0).normal(scale=noise, size=dataset.validation.shape)
    errors = []
    for input_noise in (0.0, noise):
        trained = train(replace(recipe, input_noise=input_noise), small_network, dataset).export()
        decoded = trained.decode(trained.encode(dataset.validation + disturbance))
        errors.append(np.mean((decoded - dataset.validation) ** 2))
    assert errors[1] < 0.9 * errors[0]


@pytest.mark.parametrize('recipe', RECIPES, ids=lambda recipe: recipe.name)
def test_trained_latents_have_unit_deviation(recipe, dataset, small_network):
    latent = train(recipe, small_network, dataset).export().encode(dataset.train)
    np.testing.assert_allclose(latent.mean(axis=0), 0, atol=1e-8)
    np.testing.assert_allclose(latent.std(axis=0), 1, atol=1e-8)


def test_training_repeats_itself_and_follows_its_seed(dataset, small_network):
    first = train(RECIPE, small_network, dataset)
    assert_same_bits(first, train(RECIPE, small_network, dataset))
    other = train(replace(RECIPE, seed=1), small_network, dataset)
    assert not np.array_equal(
        first.tensors()['encoder.0.weight'], other.tensors()['encoder.0.weight']
    )


@pytest.mark.parametrize('recipe', RECIPES, ids=lambda recipe: recipe.name)
@pytest.mark.parametrize('epoch', [1, 2, 5])
@pytest.mark.usefixtures('saved_every_two_epochs')
def test_a_training_cut_off_ends_like_an_unbroken_one(
    monkeypatch, tmp_path, dataset, recipe, epoch, small_network
):
    path = tmp_path / 'state.safetensors'
    cut_off(monkeypatch, recipe, small_network, dataset, path, epoch)
    assert epoch_of(path) == epoch
    resumed = train(recipe, small_network, dataset, path)
    assert_same_bits(resumed, train(recipe, small_network, dataset))
    assert list(tmp_path.iterdir()) == [path]


def test_a_training_cut_off_in_its_first_epoch_leaves_nothing(
    monkeypatch, tmp_path, dataset, small_network
):
    cut_off(monkeypatch, RECIPE, small_network, dataset, tmp_path / 'state.safetensors', 0)
    assert list(tmp_path.iterdir()) == []


def test_a_training_cut_off_again_at_once_keeps_its_state(
    monkeypatch, tmp_path, dataset, small_network
):
    path = tmp_path / 'state.safetensors'
    for _ in range(2):
        cut_off(monkeypatch, RECIPE, small_network, dataset, path, 3)
        assert epoch_of(path) == 3
    assert_same_bits(
        train(RECIPE, small_network, dataset, path), train(RECIPE, small_network, dataset)
    )


def test_a_training_killed_after_a_save_ends_like_an_unbroken_one(
    monkeypatch, tmp_path, dataset, small_network
):
    monkeypatch.setattr(training, 'SAVE_INTERVAL', 2)
    path, kept = tmp_path / 'state.safetensors', tmp_path / 'kept.safetensors'
    finish = training._TrainingState.finish_epoch

    def finish_and_keep(state, epoch, validation):
        finish(state, epoch, validation)
        if epoch == 4:  # what a kill would leave
            kept.write_bytes(path.read_bytes())

    with monkeypatch.context() as patch:
        patch.setattr(training._TrainingState, 'finish_epoch', finish_and_keep)
        unbroken = train(RECIPE, small_network, dataset, path)
    assert epoch_of(kept) == 4
    assert_same_bits(train(RECIPE, small_network, dataset, kept), unbroken)


def test_a_finished_training_is_taken_up_at_its_end(tmp_path, dataset, small_network):
    path = tmp_path / 'state.safetensors'
    first = train(RECIPE, small_network, dataset, path)
    assert epoch_of(path) == RECIPE.epochs
    assert_same_bits(train(RECIPE, small_network, dataset, path), first)


@pytest.mark.usefixtures('saved_every_two_epochs')
def test_a_training_cut_off_twice_ends_like_an_unbroken_one(
    monkeypatch, tmp_path, dataset, small_network
):
    path = tmp_path / 'state.safetensors'
    for epoch in (3, 7):
        cut_off(monkeypatch, RECIPE, small_network, dataset, path, epoch)
    assert_same_bits(
        train(RECIPE, small_network, dataset, path), train(RECIPE, small_network, dataset)
    )


@pytest.mark.usefixtures('saved_every_two_epochs')
def test_another_recipe_is_not_mixed_in(monkeypatch, tmp_path, dataset, small_network):
    path = tmp_path / 'state.safetensors'
    cut_off(monkeypatch, RECIPE, small_network, dataset, path, 3)
    with pytest.raises(ValueError, match='unfinished training by another recipe'):
        train(replace(RECIPE, learning_rate=0.01), small_network, dataset, path)
    assert path.exists()


@pytest.mark.parametrize('content', [b'', b'something else', b'\x10\0\0\0\0\0\0\0{"x"'])
def test_a_damaged_state_is_refused(tmp_path, dataset, content, small_network):
    path = tmp_path / 'state.safetensors'
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r'state\.safetensors.*remove the file'):
        train(RECIPE, small_network, dataset, path)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (lambda t, m: t.pop('module.encoder.0.weight'), r'module\.encoder\.0\.weight'),
        (lambda t, m: t.pop('best.pod_basis'), r'best\.pod_basis'),
        (lambda t, m: t.pop('adam.3.exp_avg'), r'adam\.3\.exp_avg'),
        (lambda t, m: t.update({'adam.0.exp_avg': t['adam.0.step']}), r'adam\.0\.exp_avg'),
        (lambda t, m: t.update({'best.x': t['adam.0.step']}), r'best\.x'),
        (lambda t, m: t.update({'adam.x': t['adam.0.step']}), r'adam\.x'),
        (lambda t, m: m.pop('identity'), 'identity'),
        (lambda t, m: m.pop('epoch'), 'epoch'),
        (lambda t, m: m.pop('best_validation'), 'best_validation'),
        (lambda t, m: m.update(epoch='three'), 'three'),
        (lambda t, m: m.update(epoch='-1'), 'its epoch is -1'),
        (lambda t, m: m.update(epoch='10'), 'its epoch is 10'),
        (lambda t, m: m.clear(), 'NoneType'),
    ],
)
def test_a_state_of_other_contents_is_refused(
    monkeypatch, tmp_path, dataset, change, message, small_network
):
    path = tmp_path / 'state.safetensors'
    cut_off(monkeypatch, RECIPE, small_network, dataset, path, 1)
    with safe_open(str(path), framework='pt') as file:
        tensors, metadata = {key: file.get_tensor(key) for key in file.keys()}, file.metadata()  # noqa: SIM118
    change(tensors, metadata)
    save_file({key: value.clone() for key, value in tensors.items()}, path, metadata or None)
    with pytest.raises(ValueError, match=rf'unfinished training, but .*{message}.*remove the file'):
        train(RECIPE, small_network, dataset, path)


def test_the_best_validation_epoch_is_kept(dataset, small_network):
    # A rate this high makes later epochs worse than some earlier one.
    recipe = replace(PLAIN, epochs=12, learning_rate=0.05)
    error = reconstruction_mse(train(recipe, small_network, dataset).export(), dataset.validation)
    for epochs in (1, 4, 8):
        shorter = train(replace(recipe, epochs=epochs), small_network, dataset).export()
        assert error <= reconstruction_mse(shorter, dataset.validation) * (1 + 1e-4)


def test_a_training_that_gives_no_number_fails(dataset, small_network):
    bad = replace(dataset, train=np.where(dataset.train > 0, np.nan, dataset.train))
    with pytest.raises(ValueError, match='not finite'):
        train(PLAIN, small_network, bad)


def test_weights_of_other_generators_are_left_alone(dataset, small_network):
    import torch

    torch.manual_seed(0)
    expected = torch.rand(3)
    torch.manual_seed(0)
    train(replace(RECIPE, epochs=1), small_network, dataset)
    assert torch.equal(torch.rand(3), expected)


@pytest.fixture
def experiment(tmp_path, small_network):
    """A network file and its data, by the recipe that names them."""
    save_network(small_network, tmp_path / 'grid.json')
    conditions = [
        Condition(1, 'train', Gravity(9.81), 'rest'),
        Condition(2, 'validation', Gravity(5.0, 0.3), 'continue'),
    ]
    held_out = [Condition(3, 'test', Gravity(4.0), 'rest')]
    dataset = make_dataset(small_network, conditions, held_out)
    save_dataset(dataset, tmp_path / 'data' / 'grid.npz')
    recipe = replace(RECIPE, network=str(tmp_path / 'grid.json'), epochs=3)
    return recipe, dataset, tmp_path


def test_the_checkpoint_states_its_scores_and_its_origin(experiment, small_network):
    recipe, dataset, folder = experiment
    path = train_checkpoint(recipe, folder / 'training', folder / 'data')
    checkpoint = load_checkpoint(path)
    checkpoint.check_network(small_network)
    autoencoder = checkpoint.autoencoder()
    for split in ('train', 'validation', 'test'):
        error = reconstruction_mse(autoencoder, getattr(dataset, split))
        stated = checkpoint.provenance['scores'][f'{split}_mse']
        assert stated == pytest.approx(error, rel=1e-12)
    assert checkpoint.provenance['recipe'] == recipe.as_dict()
    assert checkpoint.provenance['data']['network_digest'] == small_network.digest
    assert sorted(file.name for file in path.parent.iterdir()) == [
        'grid_m2.json',
        'grid_m2.safetensors',
    ]


def test_the_state_goes_only_after_the_checkpoint_is_written(monkeypatch, experiment):
    recipe, _, folder = experiment
    state = state_path(recipe, folder / 'training')

    def full(checkpoint, folder):
        raise OSError('no space left')

    with monkeypatch.context() as patch:
        patch.setattr(experiment_module, 'save_checkpoint', full)
        with pytest.raises(OSError, match='no space left'):
            train_checkpoint(recipe, folder / 'training', folder / 'data')
    assert list(state.parent.iterdir()) == [state]
    path = train_checkpoint(recipe, folder / 'training', folder / 'data')
    again = train_checkpoint(recipe, folder / 'again', folder / 'data')
    assert load_checkpoint(path).digest == load_checkpoint(again).digest
    assert not state.exists()


def test_data_of_another_network_are_refused(experiment, random_network):
    recipe, _, folder = experiment
    save_network(random_network(0), folder / 'grid.json')
    with pytest.raises(ValueError, match=r'holds data of grid@.* the recipe is for random@'):
        train_checkpoint(recipe, folder / 'training', folder / 'data', folder / 'data/grid.npz')
    assert not (folder / 'training').exists()
