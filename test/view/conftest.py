"""Pages of logs, and a log whose every text is hostile."""

from html.parser import HTMLParser

import pytest

from dpc_ros import cli

ATTACK = (
    '{{plotly}}</script><script>window.attacked = true</script>'
    '<img src=x onerror="window.attacked = true">'
)


class Elements(HTMLParser):
    """The elements of a page: tags with their attributes, and all text outside of scripts."""

    def __init__(self, page):
        super().__init__()
        self.found, self.text, self._tag = [], '', ''
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        self._tag = tag

    def handle_endtag(self, tag):
        self._tag = ''

    def handle_data(self, data):
        if self._tag not in ('script', 'style'):
            self.text += data

    def named(self, name):
        return [attributes for tag, attributes in self.found if tag == name]


@pytest.fixture(scope='session')
def elements():
    return Elements


@pytest.fixture(scope='session')
def attack():
    return ATTACK


@pytest.fixture
def write_page(tmp_path):
    """Return a function: bag, options of the command → path of the page of it."""

    def write(bag, *options):
        path = tmp_path / 'page.html'
        cli.main(['bag', 'report', str(bag), '--output', str(path), *map(str, options)])
        return path

    return write


@pytest.fixture(scope='session')
def hostile_bag(log_type, record):
    """A log that puts markup and scripts wherever it may put a text."""
    texts = {ATTACK: ATTACK, 'yaml': f"/**: {{ros__parameters: {{law: '{ATTACK}'}}}}"}
    names = ('parameters', 'node_parameters', 'versions', 'command', 'machine', 'models')
    log = log_type(
        configuration=[(5_000_000 * k, [0.0, 1.0], [0.0, 0.0]) for k in range(10)],
        latent=[(5_000_000 * k, [0.5], [0.0]) for k in range(10)],
        force=[(5_000_000 * k, (1.0, 2.0)) for k in range(10)],
        targets=[(0, [1.0, 1.0], False)],
        network=ATTACK,
        checkpoint=ATTACK,
        force_frames=(ATTACK,),
        metadata={**{f'dpc_ros.{name}': texts for name in names}, ATTACK: texts},
    )
    return record(log)
