"""How soon nodes find each other on DDS, and learn of what they missed."""

import os
from collections.abc import Sequence
from pathlib import Path

from dpc_ros.nodes.provenance import ros_distribution
from dpc_ros.resources import config_path

PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_PROFILES = ('fast_dds.xml', 'fast_dds_kilted.xml')  # each for the variable in its place
FAST_DDS_2 = ('humble', 'iron', 'jazzy')  # they have the first ones, later distributions the others
_NAMESPACE = '__ns:='
_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')  # where a process starts


def use_prompt_dds(arguments: Sequence[str] = ()) -> None:
    """Let Fast DDS announce often this process and those that it starts, and ask soon what is lost.

    By default it announces a process for half a second and then every three: of nodes that start
    together some miss each other and wait for the next time. And a writer asks every three seconds
    what a reader has missed that was stopped or cut off. Who has a profile of his own keeps it;
    other middleware knows nothing of this one. To be called before the first context is made.

    Args:
        arguments: of ROS, which may put the process into a namespace.
    """
    has_own = any(name in os.environ for name in PROFILE_VARIABLES)
    if not has_own and not any(Path(name).exists() for name in _FILES):
        which = ros_distribution() not in FAST_DDS_2
        profile = config_path(_PROFILES[which])
        os.environ[PROFILE_VARIABLES[which]] = str(_in_namespace(profile, _namespace(arguments)))


def _namespace(arguments: Sequence[str]) -> str:
    """Return the namespace that arguments of ROS ask for, none if it is the root."""
    remapped = [each.removeprefix(_NAMESPACE) for each in arguments if each.startswith(_NAMESPACE)]
    return '/' + remapped[-1].strip('/') if remapped and remapped[-1].strip('/') else ''


def _in_namespace(profile: Path, namespace: str) -> Path:
    """Return a profile that names the topics of a namespace, where there is one.

    It is kept among what the user's programs cache.
    """
    if not namespace:
        return profile
    text = profile.read_text().replace('profile_name="/', f'profile_name="{namespace}/')
    try:
        cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache') / 'dpc_ros'
        made = cache / f'{profile.stem}{namespace.replace("/", ".")}.xml'
        if not made.exists() or made.read_text() != text:
            cache.mkdir(parents=True, exist_ok=True)
            partial = made.with_suffix(f'.{os.getpid()}')  # other nodes may make it, too
            partial.write_text(text)
            partial.replace(made)
    except (OSError, RuntimeError):  # there is no home, or none to write to
        return profile
    return made
