"""The pages say what is true: links lead somewhere, examples run, numbers come from results."""

import json
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from dpc_ros import cli
from dpc_ros.bag.convergence_table import format_row
from dpc_ros.bag.reader import read_run
from dpc_ros.bag.rerun import rerun
from dpc_ros.network import (
    Gravity,
    Integrator,
    MassSpringNetwork,
    Mechanics,
    load_network,
    simulate,
)
from dpc_ros.resources import share_directory

ROOT = share_directory()
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]


def anchors(page):
    """Return the anchors of a page's titles, as GitHub makes them."""
    text = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.M | re.S)
    titles = re.findall(r'^#+ (.*)', text, re.M)
    return {re.sub(r'[^\w\- ]', '', title).lower().replace(' ', '-') for title in titles}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_to_files(page):
    for link, anchor in re.findall(r'\]\(([^)#]*)(?:#([^)]+))?\)', page.read_text()):
        if '://' not in link:
            target = page.parent / link if link else page
            assert target.exists(), link
            if anchor:
                assert anchor in anchors(target), anchor


def test_table_in_the_readme_is_the_recorded_result():
    recorded = json.loads((ROOT / 'docs/results/demo.json').read_text())
    readme = (ROOT / 'README.md').read_text()
    *rows, summary = recorded['rows']
    for row in rows:
        values = {key: np.nan if value is None else value for key, value in row.items()}
        assert format_row(values) in readme
    for what, key, unit in (
        ('final nMSE   ', 'final_nmse', ''),
        ('settling time', 'settling_time_s', ' s'),
        ('peak force   ', 'peak_force_N', ' N'),
        ('RMS force    ', 'rms_force_N', ' N'),
    ):
        assert f'{what}  {summary[key]:.4g}{unit}\n' in readme
    assert recorded['commit']
    assert recorded['command']


def test_example_of_the_control_page_is_the_demonstration():
    page = (ROOT / 'docs/control.md').read_text()
    example, _ = re.findall(r'```python\n(.*?)```', page, re.S)
    names = {}
    exec(example.replace('steps=1000', 'steps=20'), names)
    recorded = json.loads((ROOT / 'docs/results/demo.json').read_text())['rows']
    run = names['run']
    assert len(run.force) == 21
    # Other machines round differently in the last digits.
    assert np.linalg.norm(run.force[0]) == pytest.approx(recorded[0]['force_N'], rel=1e-6)


def test_example_of_the_reduction_page_follows_the_body():
    (example,) = re.findall(r'```python\n(.*?)```', (ROOT / 'docs/reduction.md').read_text(), re.S)
    names = {}
    exec(example, names)
    system, network = names['system'], names['network']
    rest = network.rest_configuration
    integrator = Integrator(system.mechanics, 0.02 / 4)
    force = system.full_input_field @ names['push']
    full = simulate(integrator, rest, np.zeros_like(rest), 1000, force).configuration[::4]
    error = np.linalg.norm(names['configurations'] - full)
    assert error < 0.05 * np.linalg.norm(full - rest)


def test_sample_log_is_whole():
    (bag,) = (path for path in (ROOT / 'bags').iterdir() if path.is_dir())
    run = read_run(bag)
    assert len(run.configuration) == len(run.latent) == len(run.force)
    assert not any(run.losses.values())
    assert Path(bag / 'metadata.yaml').is_file()
    assert rerun(bag).passed


def test_example_of_the_networks_page_is_a_body(tmp_path):
    page = (ROOT / 'docs/networks.md').read_text()
    (example,) = re.findall(r'```json\n(.*?)```', page, re.S)
    path = tmp_path / 'mine.json'
    path.write_text(example)
    network = load_network(path)
    mechanics, rest = Mechanics(network, Gravity(9.81)), network.rest_configuration
    run = simulate(Integrator(mechanics, 0.005), rest, np.zeros_like(rest), 2000)
    energy = [mechanics.total_energy(*s) for s in zip(run.configuration, run.velocity, strict=True)]
    assert np.diff(energy).max() <= 1e-6
    assert np.abs(run.velocity[-1]).max() < 1e-3
    assert 0 < np.abs(run.configuration - rest).max() < 0.1
    cli.main(['draw', str(path), '--output', str(tmp_path / 'mine.png')])
    assert (tmp_path / 'mine.png').read_bytes().startswith(b'\x89PNG')


def test_networks_page_names_every_key():
    page = (ROOT / 'docs/networks.md').read_text()
    (example,) = re.findall(r'```json\n(.*?)```', page, re.S)
    keys = {field.name for field in fields(MassSpringNetwork)} | {'units'}
    assert set(re.findall(r'^\| `(\w+)` \|', page, re.M)) == json.loads(example).keys() == keys


def test_generator_example_of_the_networks_page_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r'```python\n(.*?)```', (ROOT / 'docs/networks.md').read_text(), re.S)
    exec(example, {})
    assert sorted(path.name for path in tmp_path.iterdir()) == ['small.json', 'small.png']
