"""How soon nodes find each other on DDS, and learn of what they missed."""

import os
from pathlib import Path

from dpc_ros.nodes.provenance import ros_distribution
from dpc_ros.resources import config_path

PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_PROFILES = ('fast_dds.xml', 'fast_dds_kilted.xml')  # each for the variable in its place
FAST_DDS_2 = ('humble', 'iron', 'jazzy')  # they have the first ones, later distributions the others
_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')  # where a process starts


def use_prompt_dds() -> None:
    """Let Fast DDS announce often this process and those that it starts, and ask soon what is lost.

    By default it announces a process for half a second and then every three: of nodes that start
    together some miss each other and wait for the next time. And a writer asks every three seconds
    what a reader has missed that was stopped or cut off. Who has a profile of his own keeps it;
    other middleware knows nothing of this one. To be called before the first context is made.
    """
    has_own = any(name in os.environ for name in PROFILE_VARIABLES)
    if not has_own and not any(Path(name).exists() for name in _FILES):
        which = ros_distribution() not in FAST_DDS_2
        os.environ[PROFILE_VARIABLES[which]] = str(config_path(_PROFILES[which]))
