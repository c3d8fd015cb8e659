"""Parameters of other nodes, asked for by the services that every ROS 2 node has."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

Answer = Callable[[str, Mapping[str, Any]], None]

_EVENTS = '/parameter_events'  # each node has one publisher of it, if it was not told otherwise
_Incarnation = tuple[str, bytes]  # full name of a node and what tells it from others of that name


class NodeParameters:
    """Asks each node that appears for its parameters, without waiting for any.

    A node that goes and comes back is asked again, also where the graph still shows the one that
    was killed: the two are told apart by their publishers of parameter events. Hidden nodes, whose
    names start with `_`, are left alone.

    Args:
        node: through which to ask.
        answer: is called with the full name and the parameters of a node.
    """

    def __init__(self, node: Node, answer: Answer) -> None:
        self._node = node
        self._answer = answer
        self._questions: dict[_Incarnation, _Question] = {}

    def look(self) -> None:
        """Look who is there, ask the new ones, forget those who have gone."""
        present = self._present()
        for incarnation in self._questions.keys() - present:
            self._questions.pop(incarnation).close()
        for name, identity in sorted(present - self._questions.keys()):
            self._questions[name, identity] = _Question(self._node, name, self._answer)
        for question in self._questions.values():
            question.look()

    def _present(self) -> set[_Incarnation]:
        found = {
            (_full_name(each.node_name, each.node_namespace), bytes(each.endpoint_gid))
            for each in self._node.get_publishers_info_by_topic(_EVENTS)
            if not each.node_name.startswith('_')
        }
        with_events = {name for name, _ in found}
        names = {
            _full_name(name, namespace)
            for name, namespace in self._node.get_node_names_and_namespaces()
            if not name.startswith('_')
        }
        return found | {(name, b'') for name in names - with_events}

    def close(self) -> None:
        """Let go of everything."""
        for question in self._questions.values():
            question.close()
        self._questions.clear()


class _Question:
    """What are your parameters, and what their values? Asked once the services are there.

    Asked again, ever less often, until the answer comes: a question may go to one who is no more.
    """

    def __init__(self, node: Node, name: str, answer: Answer) -> None:
        self._node = node
        self._name = name
        self._answer = answer
        self._looks = 0  # since the services are there
        self._answered = False
        self._clients: list[Client] = [
            node.create_client(ListParameters, f'{name}/list_parameters'),
            node.create_client(GetParameters, f'{name}/get_parameters'),
        ]

    def look(self) -> None:
        if self._answered:
            self.close()
        elif all(client.service_is_ready() for client in self._clients):
            self._looks += 1
            if self._looks.bit_count() == 1:  # 1, 2, 4, 8, …
                lister, _ = self._clients
                lister.call_async(ListParameters.Request()).add_done_callback(self._take_names)

    def close(self) -> None:
        for client in self._clients:
            self._node.destroy_client(client)
        self._clients.clear()

    def _take_names(self, future: Future) -> None:
        if self._clients and not self._answered and future.result() is not None:
            names = sorted(future.result().result.names)
            _, getter = self._clients
            request = GetParameters.Request(names=names)
            getter.call_async(request).add_done_callback(partial(self._take_values, names))

    def _take_values(self, names: list[str], future: Future) -> None:
        if self._clients and not self._answered and future.result() is not None:
            values = map(parameter_value_to_python, future.result().values)
            # Where a parameter went meanwhile a node may answer with fewer values than names.
            pairs = zip(names, values, strict=False)
            self._answer(self._name, {name: _plain(value) for name, value in pairs})
            self._answered = True


def _full_name(name: str, namespace: str) -> str:
    return f'{namespace.rstrip("/")}/{name}'


def _plain(value: Any) -> Any:
    """Return arrays as lists, the rest as it is."""
    return value if isinstance(value, (str, bytes)) or not hasattr(value, '__len__') else [*value]
