"""The page in a browser, offline: all is drawn, one time moves all, and nothing hostile runs."""

import re

import numpy as np
import pytest

from dpc_ros.network import save_network
from dpc_ros.resources import share_directory

SAMPLE = share_directory() / 'bags' / 'demo_1s'
STEP = 5_000_000  # ns
GIVE_UP = 60_000  # ms
ALL_DRAWN = (
    "() => [...document.querySelectorAll('.plot')].every((p) => p.querySelector('.main-svg'))"
)
POINTS = """() => [...document.querySelectorAll('.plot')].map((plot) => plot.data.map(
    (curve, i) => plot.calcdata[i].filter((point) => Number.isFinite(point.y)).length))"""
INKED = """() => {
    const canvas = document.querySelector('canvas');
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    return data.reduce((sum, value, i) => sum + (i % 4 === 3 && value > 0), 0);
}"""
PICTURE = "() => document.querySelector('canvas').toDataURL()"
COLOURS = """() => [
    getComputedStyle(document.body).color,
    ...[...document.querySelectorAll('.plot')].map((plot) => plot.layout.font.color),
]"""
CURSOR = "() => parseFloat(document.querySelector('.cursor').style.left)"


@pytest.fixture
def open_report(open_page):
    """Return a function: path → the page, all of its plots drawn."""

    def opened(path):
        page = open_page(path.as_uri(), offline=True, color_scheme='light')
        page.wait_for_function(ALL_DRAWN, timeout=GIVE_UP)
        return page

    return opened


def after_frame(page):
    page.evaluate('() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))')


def time_of(page):
    return float(page.locator('.time').inner_text().removesuffix(' s'))


def scrub_to(page, time):
    page.locator('.scrub').fill(str(time))
    after_frame(page)


def test_all_is_drawn_moves_with_one_time_and_fits_window_and_theme(write_page, open_report):
    page = open_report(write_page(SAMPLE))
    points = page.evaluate(POINTS)
    assert len(points) == 6
    assert all(count > 1 for curves in points for count in curves)

    after_frame(page)
    first = page.evaluate(PICTURE)
    assert page.evaluate(INKED) > 1000
    scrub_to(page, 0.5)
    assert time_of(page) == 0.5
    moved = page.evaluate(PICTURE)
    assert moved != first

    # The sample is a second long: a click in the middle of a plot, where its cursor is, too.
    at_half = page.evaluate(CURSOR)
    scrub_to(page, 0.1)
    assert page.evaluate(CURSOR) < at_half
    plot = page.locator('.plot').first
    box = plot.bounding_box()
    middle = box['x'] + at_half, box['y'] + box['height'] / 2
    page.mouse.move(*middle)
    plot.locator('.hoverlayer *').first.wait_for(state='attached')
    page.mouse.click(*middle)
    page.wait_for_function("() => document.querySelector('.time').innerText !== '0.100 s'")
    assert time_of(page) == pytest.approx(0.5, abs=0.01)
    assert page.evaluate(CURSOR) == pytest.approx(at_half, abs=5)

    for key, expected in (('ArrowRight', 1), ('ArrowLeft', -1)):
        before = time_of(page)
        page.keyboard.press(key)
        assert np.sign(time_of(page) - before) == expected
    for layer in ('target', 'reconstruction', 'force'):
        before = page.evaluate(PICTURE)
        page.locator(f'[data-layer={layer}]').uncheck()
        after_frame(page)
        assert page.evaluate(PICTURE) != before

    scrub_to(page, 0)
    page.locator('.speed').select_option('10')
    page.locator('.play').focus()
    page.keyboard.press('Space')
    page.locator('.play[aria-label=Play]').wait_for()
    assert time_of(page) == 1.0  # the end of the run
    assert page.evaluate("() => performance.getEntriesByType('resource').length") == 0

    page.set_viewport_size({'width': 500, 'height': 900})
    page.wait_for_function('() => document.documentElement.scrollWidth <= 500')
    before = page.evaluate(COLOURS)
    page.emulate_media(color_scheme='dark')
    differ = f'(before) => ({COLOURS})().every((each, i) => each !== before[i])'
    page.wait_for_function(differ, arg=before)
    assert page.errors == []


def test_nothing_hostile_runs(hostile_bag, write_page, open_report):
    page = open_report(write_page(hostile_bag))
    assert page.evaluate('() => window.attacked') is None
    assert page.locator('.plot').count() == 4
    assert page.errors == []
    # Not even what came into the page by another way.
    page.evaluate("""() => {
        const script = document.createElement('script');
        script.textContent = 'window.attacked = true';
        document.body.append(script);
    }""")
    assert page.evaluate('() => window.attacked') is None
    assert any('Content Security Policy' in error for error in page.errors)


@pytest.fixture
def square_page(square_network, log_type, record, write_page, tmp_path):
    """Return a function: configurations, one each step → the page of a log of the square."""

    def write(configurations, is_known=True, **others):
        save_network(square_network, tmp_path / 'square.json')
        states = [(STEP * k, q, np.zeros(4)) for k, q in enumerate(configurations)]
        log = log_type(configuration=states, network=square_network.identifier, **others)
        return write_page(
            record(log), *(['--network', tmp_path / 'square.json'] if is_known else [])
        )

    return write


def test_a_log_of_configurations_alone_has_a_page(square_page, square_network, open_report):
    rest = square_network.rest_configuration
    page = open_report(square_page([rest * (1 + k / 100) for k in range(30)]))
    for key in ('No target was in force', 'No latent state', 'No force', 'checkpoint is not known'):
        assert page.get_by_text(re.compile(key)).count() == 1
    assert page.locator('.plot').count() == 2  # energy, timing
    scrub_to(page, 0.1)
    assert page.evaluate(INKED) > 100
    assert page.errors == []


def test_a_log_of_one_message_has_a_page(square_page, square_network, open_report):
    page = open_report(square_page([square_network.rest_configuration]))
    assert page.locator('.scrub').is_disabled()
    after_frame(page)
    assert page.evaluate(INKED) > 100
    assert page.errors == []


def test_a_body_that_explodes_has_a_page(square_page, square_network, open_report):
    rest = square_network.rest_configuration
    states = [*[rest] * 10, rest + 1e200, rest + np.inf, rest * np.nan]
    forces = [(STEP * k, (10.0 ** (25 * k), np.nan if k > 11 else 1.0)) for k in range(13)]
    targets = [(0, 2 * rest, False)]
    page = open_report(square_page(states, force=forces, targets=targets))
    assert page.get_by_text(re.compile('Failed')).count() >= 1
    for time in (0.06, 0, 0.03):
        scrub_to(page, time)
        assert page.evaluate(INKED) > 100
    assert page.errors == []


def test_a_body_that_is_not_known_has_a_page(square_page, square_network, open_report):
    rest = square_network.rest_configuration
    targets = [(0, 2 * rest, False)]
    page = open_report(square_page([rest, 1.1 * rest, 1.2 * rest], False, targets=targets))
    assert page.locator('canvas').count() == 0
    assert page.locator('.plot').count() == 2  # error, timing
    page.locator('.plot').first.click()
    page.keyboard.press('Space')
    assert page.errors == []
