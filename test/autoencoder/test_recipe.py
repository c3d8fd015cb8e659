"""Recipes are checked before anything is simulated or trained."""

import json
from dataclasses import fields

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.autoencoder.recipe import Recipe, load_recipe


def write(tmp_path, text):
    path = tmp_path / 'recipe.yaml'
    path.write_text(text)
    return path


@pytest.mark.parametrize('name', ['paper_2_flat_m2', 'paper_2_extended_m5'])
def test_shipped_recipes_name_themselves(name):
    recipe = load_recipe(name)
    assert (recipe.name, recipe.network) == (name, 'paper_2')


def test_defaults_are_filled_in(tmp_path):
    recipe = load_recipe(write(tmp_path, 'name: mine\nnetwork: paper_1\n'))
    assert recipe == Recipe(name='mine', network='paper_1')
    assert recipe.as_dict().keys() == {field.name for field in fields(Recipe)}


def test_a_recipe_comes_back_from_json(tmp_path):
    text = 'name: mine\nnetwork: paper_1\nskip: true\npod_size: 60\noptimizer: adamw\n'
    text += 'options: {units: [3, 4], name: wide, deep: {wide: true, by: null}}\n'
    recipe = load_recipe(write(tmp_path, text))
    assert recipe.pod_size == 60
    assert recipe.options == {'units': [3, 4], 'name': 'wide', 'deep': {'wide': True, 'by': None}}
    assert Recipe(**json.loads(json.dumps(recipe.as_dict()))) == recipe


@pytest.mark.parametrize(
    ('line', 'message'),
    [
        ('depth: 3', r"unknown keys \['depth'\]"),
        ('1: 2\nb: 3', r'unknown keys'),
        ('latent_size: 0', r'latent_size: expected a whole number ≥ 1, got 0'),
        ('latent_size: 2.5', r'latent_size: expected a whole number'),
        ('latent_size: true', r'latent_size: expected a whole number'),
        ('epochs: many', r"epochs: expected a whole number ≥ 1, got 'many'"),
        ('batch_size: -1', r'batch_size: expected a whole number'),
        ('step_epochs: 0', r'step_epochs: expected a whole number'),
        ('learning_rate: 1e-3', r"learning_rate: expected a number \(YAML: 1\.0e-3\), got '1e-3'"),
        ('learning_rate: -0.1', r'learning_rate: expected a finite number ≥ 0'),
        ('learning_rate: .nan', r'learning_rate: expected a finite number'),
        ('weight_decay: .inf', r'weight_decay: expected a finite number'),
        ('step_factor: null', r'step_factor: expected a number'),
        ('schedule: cosine', r"schedule 'cosine': expected one of \['one_cycle', 'step'\]"),
        ('activation: relu', r"activation 'relu': expected one of"),
        ('hidden_sizes: 300', r'hidden_sizes: expected'),
        ('hidden_sizes: [300, 0]', r'hidden_sizes: expected'),
        ('hidden_sizes: [300, wide]', r'hidden_sizes: expected'),
        ('skip: perhaps', r"skip: expected true or false, got 'perhaps'"),
        ('seed: one', r"seed: expected a whole number ≥ 0, got 'one'"),
        ('seed: -1', r'seed: expected a whole number ≥ 0'),
        ('kind: wavelet', r"kind 'wavelet': expected one of \['flat', 'graph', 'pod'"),
        ('kind: [flat]', r"kind \['flat'\]: expected one of"),
        ('channels: 0', r'channels: expected a whole number ≥ 1, got 0'),
        ('convolutions: 1', r'convolutions: expected a whole number ≥ 2, got 1'),
        ('node_features: 1.5', r'node_features: expected a whole number ≥ 1'),
        ('extra_simulations: -1', r'extra_simulations: expected a whole number ≥ 0, got -1'),
        ('pod_size: -1', r'pod_size: expected a whole number ≥ 0, got -1'),
        ('pod_size: true', r'pod_size: expected a whole number ≥ 0, got True'),
        ('pod_size: 40', r'pod_size 40: expected skip'),
        ('skip: true\npod_size: 4', r'pod_size 4: .*at least latent_size 5'),
        ('optimizer: sgd', r"optimizer 'sgd': expected one of \('adam', 'adamw'\)"),
        ('options: [64]', r'options: expected names and values that JSON can hold, got \[64\]'),
        ('options: {since: 2020-01-01}', r'options: expected names and values that JSON'),
        ('options: {rate: .nan}', r'options: expected names and values that JSON'),
        ('options: {1: 2}', r'options: expected names and values that JSON'),
    ],
)
def test_bad_values_are_refused(tmp_path, line, message):
    path = write(tmp_path, f'name: mine\nnetwork: paper_1\n{line}\n')
    with pytest.raises(ValueError, match=message) as caught:
        load_recipe(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'expected keys and values'),
        ('- name\n- network\n', 'expected keys and values, got a list'),
        ('name: [mine\n', 'expected YAML'),
        ('name: !!python/object/apply:os.getcwd []\nnetwork: paper_1\n', 'expected YAML'),
        ('network: paper_1\n', 'name'),
        ('name: mine\n', 'network'),
        ('name: 3\nnetwork: paper_1\n', 'name: expected'),
        ('name: ../mine\nnetwork: paper_1\n', 'name: expected'),
        ('name: mine\nnetwork: 2\n', 'network: expected'),
    ],
)
def test_bad_files_are_refused(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        load_recipe(path)
    assert str(path) in str(caught.value)


@given(st.integers(1, 20), st.integers(1, 8), st.floats(0.1, 1.0), st.integers(1, 5))
def test_step_schedule_is_torchs(epochs, step_epochs, factor, steps_per_epoch):
    recipe = Recipe('r', 'n', epochs=epochs, step_epochs=step_epochs, step_factor=factor)
    optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=recipe.learning_rate)
    schedule = torch.optim.lr_scheduler.StepLR(optimizer, step_epochs, factor)
    for epoch in range(epochs):
        for k in range(steps_per_epoch):
            rate = recipe.learning_rate_at(epoch * steps_per_epoch + k, steps_per_epoch)
            assert rate == pytest.approx(optimizer.param_groups[0]['lr'], rel=1e-12)
        optimizer.step()
        schedule.step()


@given(st.integers(1, 30), st.integers(1, 30), st.floats(1e-5, 1e-1))
def test_one_cycle_rises_to_its_peak_and_falls_to_nearly_nothing(epochs, steps, peak):
    recipe = Recipe('r', 'n', epochs=epochs, schedule='one_cycle', learning_rate=peak)
    rates = [recipe.learning_rate_at(k, steps) for k in range(epochs * steps)]
    highest = rates.index(max(rates))
    assert rates[0] == pytest.approx(peak / 25)
    assert all(0 < rate <= peak * (1 + 1e-12) for rate in rates)
    assert rates[: highest + 1] == sorted(rates[: highest + 1])
    assert rates[highest:] == sorted(rates[highest:], reverse=True)
    if len(rates) > 1:
        assert rates[-1] == pytest.approx(peak / 25 / 1e4)
    if len(rates) > 100:
        assert highest / len(rates) == pytest.approx(0.3, abs=0.02)
        assert rates[highest] == pytest.approx(peak, rel=1e-3)
