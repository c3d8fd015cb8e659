"""Which topics a recorder takes: names and patterns, and those left out."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from fnmatch import fnmatchcase

_WILDCARDS = re.compile(r'[*?\[]')
_NAME = re.compile(r'(/|~/)?[A-Za-z_]\w*(/[A-Za-z_]\w*)*')
_PATTERN = re.compile(r'[\w/*?\[\]!-]+')


class TopicSelection:
    """Topics by name, or by a pattern as a shell has it: `*` is any text, `?` a character.

    Relative ones stand in the namespace. A `*` reaches over `/`, so that `/*` is every topic; but a
    pattern leaves out hidden topics, those with a part that starts with `_`.

    Args:
        topics: names and patterns to take.
        excluded: names and patterns to leave out of these.
        namespace: absolute, `/` or `/body_2`.
        resolve: gives the absolute name of a name; prefixes the namespace where left out.

    Attributes:
        names: absolute names of the topics that are taken by name.

    Raises:
        ValueError: a name or pattern is none.
    """

    def __init__(
        self,
        topics: Iterable[str],
        excluded: Iterable[str] = (),
        namespace: str = '/',
        resolve: Callable[[str], str] | None = None,
    ) -> None:
        self._namespace = namespace.rstrip('/')
        self._resolve = resolve or self._absolute
        names, self._patterns = self._split('topics', topics)
        self._excluded_names, self._excluded_patterns = self._split('exclude', excluded)
        self.names = tuple(name for name in names if not self._excludes(name))

    def selects(self, topic: str) -> bool:
        """Return whether a topic, given by its absolute name, is to be taken."""
        if topic in self.names:
            return True
        is_hidden = '/_' in topic
        return not is_hidden and _matches(topic, self._patterns) and not self._excludes(topic)

    def _excludes(self, topic: str) -> bool:
        return topic in self._excluded_names or _matches(topic, self._excluded_patterns)

    def _split(self, parameter: str, items: Iterable[str]) -> tuple[list[str], list[str]]:
        names, patterns = [], []
        for item in items:
            is_pattern = _WILDCARDS.search(item)
            if not (_PATTERN if is_pattern else _NAME).fullmatch(item):
                raise ValueError(
                    f'{parameter}: expected names of topics, as configuration or /diagnostics, or '
                    f"patterns, as '/body_2/*', got {item!r}"
                )
            if is_pattern:
                patterns.append(self._absolute(item))
            else:
                names.append(self._resolve(item))
        return names, patterns

    def _absolute(self, name: str) -> str:
        return name if name.startswith('/') else f'{self._namespace}/{name}'


def _matches(topic: str, patterns: list[str]) -> bool:
    return any(fnmatchcase(topic, pattern) for pattern in patterns)
