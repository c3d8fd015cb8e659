"""How nodes find and reach each other on DDS, and how soon they learn of what they missed."""

import contextlib
import hashlib
import os
import re
import socket
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from rclpy.utilities import get_rmw_implementation_identifier

from dpc_ros.nodes.health import DIAGNOSTICS
from dpc_ros.resources import config_path

RANGE_VARIABLE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
PEERS_VARIABLE = 'ROS_STATIC_PEERS'
LOCAL_VARIABLE = 'ROS_LOCALHOST_ONLY'  # which distributions up to Jazzy still obey
TRANSPORTS_VARIABLE = 'FASTDDS_BUILTIN_TRANSPORTS'
_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')  # where a process starts
_NAMESPACE = '__ns:='
_THIS_HOST = '127.0.0.1'


class FastDds(NamedTuple):
    """What sets one Fast DDS apart from others: library, variable and file of a profile."""

    library: str
    variable: str
    profile: str
    has_local_variable: bool


FAST_DDS = (
    FastDds('libfastrtps.so', 'FASTRTPS_DEFAULT_PROFILES_FILE', 'fast_dds.xml', True),  # 2: Jazzy
    FastDds('libfastdds.so', 'FASTDDS_DEFAULT_PROFILES_FILE', 'fast_dds_kilted.xml', False),  # 3
)
_given_here: set[Path] = set()  # profiles; Fast DDS reads the first one and no other


@contextlib.contextmanager
def prompt_dds(arguments: Sequence[str] = ()) -> Iterator[None]:
    """Let Fast DDS announce this process often, repeat soon what is lost, and share no memory.

    For the first context of the process, which is to be made within this. By default Fast DDS
    announces a process for half a second and then every three: of nodes that start together some
    miss each other and wait for the next time. And a writer asks every three seconds what a reader
    has missed that was stopped or cut off. A long message it leaves to IP, by which it is lost with
    any of its packets: it leaves in pieces of one packet here, unless discovery is left to this
    host. In shared memory a process that was stopped can take one
    that works for a dead one, for good. ROS shares memory always where discovery is left to this
    host: there a profile says the same instead.

    Who has a profile of his own keeps it; other middleware knows nothing of this one. Processes
    that are started later and come here find a profile for themselves.

    Args:
        arguments: of ROS, which may put the process into a namespace.
    """
    fast_dds = loaded_fast_dds()
    if fast_dds is None:
        yield
        return
    shipped = config_path(fast_dds.profile)
    _forget_ours(shipped)
    if _has_own():
        yield
        return
    peers = _only_peers(fast_dds)
    profile = _adapted(shipped, _namespace(arguments), peers)
    os.environ[fast_dds.variable] = str(profile)  # read when the first node is made
    _given_here.add(profile)
    says_who = peers and profile != shipped and len(_given_here) == 1
    leave_it_to_the_profile = {RANGE_VARIABLE: 'SYSTEM_DEFAULT', LOCAL_VARIABLE: None}
    with _variables(leave_it_to_the_profile if says_who else {}):
        yield


def loaded_fast_dds() -> FastDds | None:
    """Return which one this process has loaded; None if it has none, or no way to tell."""
    get_rmw_implementation_identifier()  # now at least
    try:
        maps = Path('/proc/self/maps').read_text()
    except OSError:  # not Linux
        return None
    return next((each for each in FAST_DDS if each.library in maps), None)


def _forget_ours(shipped: Path) -> None:
    """Let a profile that the process that started this one has found for itself not count here."""
    for each in FAST_DDS:
        path = Path(os.environ.get(each.variable, ''))
        if path == shipped or path.parent == _cache():
            del os.environ[each.variable]


def _has_own() -> bool:
    """Return whether the user has a profile of his own."""
    given = any(os.environ.get(each.variable) for each in FAST_DDS)
    return given or any(Path(name).exists() for name in _FILES)


def _namespace(arguments: Sequence[str]) -> str:
    """Return the namespace that arguments of ROS ask for, none if it is the root."""
    remapped = [each.removeprefix(_NAMESPACE) for each in arguments if each.startswith(_NAMESPACE)]
    return '/' + remapped[-1].strip('/') if remapped and remapped[-1].strip('/') else ''


def _only_peers(fast_dds: FastDds) -> list[str]:
    """Return to which addresses discovery is limited; none where it is not, or ROS sees to it."""
    if fast_dds.has_local_variable and os.environ.get(LOCAL_VARIABLE) == '1':
        return [_THIS_HOST]
    if os.environ.get(RANGE_VARIABLE) != 'LOCALHOST':
        return []
    names = filter(None, os.environ.get(PEERS_VARIABLE, '').split(';'))
    try:
        return [_THIS_HOST, *map(socket.gethostbyname, names)]
    except (OSError, UnicodeError):  # ROS says so
        return []


def _adapted(profile: Path, namespace: str, peers: Sequence[str]) -> Path:
    """Return a profile with the topics of a namespace, the only peers, the transports chosen.

    Where there are any. It is kept among what the user's programs cache; where it can't be, the
    profile is as it was.
    """
    folder = _cache()
    has_chosen = bool(os.environ.get(TRANSPORTS_VARIABLE))
    if folder is None or not (namespace or peers or has_chosen):
        return profile
    text = profile.read_text().replace('profile_name="/', f'profile_name="{namespace}/')
    text = text.replace(f'"{namespace}{DIAGNOSTICS}"', f'"{DIAGNOSTICS}"')  # of all namespaces
    if has_chosen:
        text = re.sub('<userTransports>.*</useBuiltinTransports>', '', text, flags=re.DOTALL)
    if peers == [_THIS_HOST]:  # no network that loses pieces, which take time
        text = re.sub('<propertiesPolicy>.*</propertiesPolicy>', '', text, flags=re.DOTALL)
    text = _with_peers(text, peers)
    made = folder / f'{profile.stem}_{hashlib.sha256(text.encode()).hexdigest()[:16]}.xml'
    try:
        if not made.exists() or made.read_bytes() != text.encode():
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder) as drafts:  # others may make it, too
                draft = Path(drafts, made.name)
                draft.write_text(text)
                draft.replace(made)
    except OSError:
        return profile
    return made


def _cache() -> Path | None:
    """Return our folder in what the user's programs cache; None if he has no home."""
    given = Path(os.environ.get('XDG_CACHE_HOME', ''))
    try:
        return (given if given.is_absolute() else Path.home() / '.cache') / 'dpc_ros'
    except RuntimeError:
        return None


def _with_peers(profile: str, peers: Sequence[str]) -> str:
    """Return a profile by which a process asks these addresses alone who is there."""
    if not peers:
        return profile
    locators = ''.join(
        f'<locator><udpv4><address>{peer}</address></udpv4></locator>' for peer in peers
    )
    # A locator without an address is every address of this host, and no group.
    return profile.replace(
        '</builtin>',
        '<metatrafficUnicastLocatorList><locator><udpv4/></locator></metatrafficUnicastLocatorList>'
        f'<initialPeersList>{locators}</initialPeersList></builtin>',
    )


@contextlib.contextmanager
def _variables(values: Mapping[str, str | None]) -> Iterator[None]:
    """Let variables of the environment have other values for a while, or none."""
    before = {name: os.environ.get(name) for name in values}
    _set_variables(values)
    try:
        yield
    finally:
        _set_variables(before)


def _set_variables(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
