"""How soon nodes find each other on DDS."""

import os
from pathlib import Path

from dpc_ros.nodes.provenance import ros_distribution
from dpc_ros.resources import config_path

PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
_FIRST_NAME_IN = ('humble', 'iron', 'jazzy')  # the others call the first one deprecated
_FILES = ('DEFAULT_FASTRTPS_PROFILES.xml', 'DEFAULT_FASTDDS_PROFILES.xml')  # where a process starts


def announce_often() -> None:
    """Let Fast DDS announce this process, and those that it starts, often in their first seconds.

    By default it does so for half a second and then every three: of nodes that start together some
    miss each other and wait for the next time. Who has a profile of his own keeps it; other
    middleware knows nothing of this one. To be called before the first context is initialised.
    """
    has_own = any(name in os.environ for name in PROFILE_VARIABLES)
    if not has_own and not any(Path(name).exists() for name in _FILES):
        variable = PROFILE_VARIABLES[ros_distribution() not in _FIRST_NAME_IN]
        os.environ[variable] = str(config_path('fast_dds.xml'))
