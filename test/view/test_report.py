"""The file of a page: whole, alone, and never more than text of what a log says."""

import base64
import hashlib
import json
import re

import pytest

from dpc_ros import cli
from dpc_ros.resources import share_directory

SAMPLE = share_directory() / 'bags' / 'demo_1s'


@pytest.fixture
def sample_page(write_page):
    return write_page(SAMPLE)


def content(page):
    (text,) = re.findall(r'<script type="application/json" id="content">(.*?)</script>', page)
    return json.loads(text)


def test_a_page_says_what_converge_says(sample_page, elements, capsys):
    text = elements(sample_page.read_text()).text
    cli.main(['bag', 'converge', str(SAMPLE), '--figure', str(sample_page.with_suffix('.png'))])
    shown = capsys.readouterr().out
    for name in ('final nMSE', 'settling time', 'peak force', 'RMS force'):
        (value,) = re.findall(rf'^{name} +(.+)$', shown, re.M)
        assert value in text
    for identifier in re.findall(r'\S+@\S+', shown):
        assert identifier in text
    for topic in re.findall(r'^/\S+', shown, re.M):
        assert topic in text


def test_a_page_lets_run_its_own_scripts_only_and_loads_nothing(sample_page, elements):
    page = sample_page.read_text()
    found = elements(page)
    (policy,) = (meta['content'] for meta in found.named('meta') if meta.get('http-equiv'))
    rules = dict(rule.strip().split(' ', 1) for rule in policy.split(';'))
    assert rules['default-src'] == "'none'"
    scripts = re.findall(r'<script>(.*?)</script>', page, re.S)
    digests = [base64.b64encode(hashlib.sha256(each.encode()).digest()) for each in scripts]
    assert rules['script-src'].split() == [f"'sha256-{each.decode()}'" for each in digests]
    for _, attributes in found.found:
        assert attributes.get('src') is None
        assert attributes.get('href') in (None, 'data:,')


def test_whatever_a_log_says_is_text(hostile_bag, write_page, elements, attack):
    page = write_page(hostile_bag).read_text()
    found = elements(page)
    assert len(found.named('script')) == 3
    assert found.named('img') == []
    assert found.text.count(attack) > 20
    assert content(page)['animation'] is None


def test_a_page_is_beside_the_log_unless_named(record, small_log, capsys):
    bag = record(small_log)
    cli.main(['bag', 'report', str(bag)])
    assert capsys.readouterr().out.splitlines()[-1] == f'report      {bag / "report.html"}'
    cli.main(['bag', 'report', str(bag / 'bag_0.mcap')])
    assert capsys.readouterr().out.splitlines()[-1] == f'report      {bag / "report.html"}'
    assert (bag / 'report.html').read_text().endswith('</html>\n')


def test_a_page_that_can_not_be_written_leaves_nothing(record, small_log, tmp_path, capsys):
    (tmp_path / 'file').touch()
    output = tmp_path / 'file' / 'page.html'
    with pytest.raises(SystemExit) as caught:
        cli.main(['bag', 'report', str(record(small_log)), '--output', str(output)])
    assert caught.value.code == 2
    shown = capsys.readouterr()
    assert shown.err.startswith(f"error: {output} can't be written")
    assert 'report ' not in shown.out
    assert [*tmp_path.iterdir()] == [tmp_path / 'file']


def test_an_unknown_network_is_said_and_can_be_named(
    log_type, record, square_network, write_page, elements, tmp_path
):
    from dpc_ros.network import save_network

    rest = square_network.rest_configuration
    states = [(5_000_000 * k, rest, 0 * rest) for k in range(10)]
    bag = record(log_type(configuration=states, network=square_network.identifier))
    page = write_page(bag).read_text()
    assert content(page)['animation'] is None
    assert 'name the file of the network by --network' in elements(page).text
    save_network(square_network, tmp_path / 'square.json')
    page = write_page(bag, '--network', tmp_path / 'square.json').read_text()
    assert content(page)['animation']['samples'] == 10
