"""How nodes find and reach each other on DDS, and how soon they learn of what they missed."""

import hashlib
import os
import socket
from collections.abc import Sequence
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

from dpc_ros.nodes.provenance import ros_distribution
from dpc_ros.resources import config_path

PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
RANGE_VARIABLE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
PEERS_VARIABLE = 'ROS_STATIC_PEERS'
LOCAL_VARIABLE = 'ROS_LOCALHOST_ONLY'  # of older distributions; rcl still obeys it
FAST_DDS_2 = ('humble', 'iron', 'jazzy')  # they have the first profile, all later ones the second
_PROFILES = ('fast_dds.xml', 'fast_dds_kilted.xml')  # each for the variable in its place
_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')  # where a process starts
_NAMESPACE = '__ns:='
_THIS_HOST = '127.0.0.1'


def use_prompt_dds(arguments: Sequence[str] = ()) -> None:
    """Let Fast DDS announce often this process and those it starts, and not share memory.

    By default it announces a process for half a second and then every three: of nodes that start
    together some miss each other and wait for the next time. And a writer asks every three seconds
    what a reader has missed that was stopped or cut off. In shared memory a process that was
    stopped can take one that works for a dead one, for good; ROS always has it where discovery is
    left to this host (`LOCALHOST`), and so a profile says the same here.

    Who has a profile of his own keeps it; other middleware knows nothing of this one. To be called
    before the first context is made.

    Args:
        arguments: of ROS, which may put the process into a namespace.
    """
    has_own = any(name in os.environ for name in PROFILE_VARIABLES)
    if has_own or any(Path(name).exists() for name in _FILES):
        return
    if not get_rmw_implementation_identifier().startswith('rmw_fastrtps'):
        return
    which = ros_distribution() not in FAST_DDS_2
    shipped, peers = config_path(_PROFILES[which]), _only_peers()
    adapted = _adapted(shipped, _namespace(arguments), peers)
    os.environ[PROFILE_VARIABLES[which]] = str(adapted)
    if peers and adapted != shipped:
        os.environ[RANGE_VARIABLE] = 'SYSTEM_DEFAULT'  # ROS leaves discovery to the profile


def _namespace(arguments: Sequence[str]) -> str:
    """Return the namespace that arguments of ROS ask for, none if it is the root."""
    remapped = [each.removeprefix(_NAMESPACE) for each in arguments if each.startswith(_NAMESPACE)]
    return '/' + remapped[-1].strip('/') if remapped and remapped[-1].strip('/') else ''


def _only_peers() -> list[str]:
    """Return to which addresses discovery is limited; none where it is not, or ROS sees to it."""
    if os.environ.get(RANGE_VARIABLE) != 'LOCALHOST' or os.environ.get(LOCAL_VARIABLE) == '1':
        return []
    names = filter(None, os.environ.get(PEERS_VARIABLE, '').split(';'))
    try:
        return [_THIS_HOST, *map(socket.gethostbyname, names)]
    except OSError:  # ROS says so
        return []


def _adapted(profile: Path, namespace: str, peers: Sequence[str]) -> Path:
    """Return a profile that names the topics of a namespace and the only peers, if there are any.

    It is kept among what the user's programs cache; where it can't be, the profile is as it was.
    """
    if not namespace and not peers:
        return profile
    text = profile.read_text()
    key = hashlib.sha256('\n'.join([text, namespace, *peers]).encode()).hexdigest()[:16]
    try:
        cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache') / 'dpc_ros'
        made = cache / f'{profile.stem}_{key}.xml'
        if not made.exists():
            cache.mkdir(parents=True, exist_ok=True)
            partial = made.with_suffix(f'.{os.getpid()}')  # other nodes may make it, too
            named = text.replace('profile_name="/', f'profile_name="{namespace}/')
            partial.write_text(_with_peers(named, peers))
            partial.replace(made)
    except (OSError, RuntimeError):  # there is no home, or none to write to
        return profile
    return made


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
