import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.nodes.topic_selection import TopicSelection

PART = st.from_regex(r'[a-z][a-z0-9_]{0,5}', fullmatch=True)
TOPIC = st.lists(PART, min_size=1, max_size=4).map(lambda parts: '/' + '/'.join(parts))


@given(topic=TOPIC, others=st.lists(TOPIC, max_size=3))
def test_a_name_selects_that_topic_and_no_other(topic, others):
    selection = TopicSelection([topic])
    assert selection.names == (topic,)
    for other in (topic, *others):
        assert selection.selects(other) == (other == topic)
    assert not TopicSelection([topic], ['/*']).selects(topic)


@given(topic=TOPIC)
def test_everything_is_selected_by_a_star_but_what_is_hidden(topic):
    assert TopicSelection(['/*']).selects(topic)
    assert not TopicSelection(['/*']).selects(f'{topic}/_hidden')
    assert not TopicSelection(['/*'], [topic]).selects(topic)
    assert TopicSelection([f'{topic}/_hidden']).selects(f'{topic}/_hidden')


@pytest.mark.parametrize('namespace', ['/body_2', '/body_2/'])
def test_relative_ones_stand_in_the_namespace(namespace):
    selection = TopicSelection(['force', '*_state', '/clock'], ['raw_*'], namespace)
    for topic in ('/body_2/force', '/body_2/latent_state', '/clock'):
        assert selection.selects(topic)
    for topic in ('/force', '/latent_state', '/body_2/clock', '/body_2/raw_state'):
        assert not selection.selects(topic)


def test_names_are_resolved_as_the_node_does():
    selection = TopicSelection(['force'], resolve={'force': '/remapped'}.__getitem__)
    assert selection.selects('/remapped')
    assert not selection.selects('/force')


@pytest.mark.parametrize('wrong', ['', 'a b', '/a/', 'a//b', '1st', '/*;'])
def test_what_is_no_topic_is_refused(wrong):
    for topics, excluded in (([wrong], []), ([], [wrong])):
        with pytest.raises(ValueError, match='expected names of topics'):
            TopicSelection(topics, excluded)
