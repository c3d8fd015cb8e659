"""Package dpc_ros, for pip as for colcon (ament_python)."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = 'dpc_ros'
ROOT = Path(__file__).resolve().parent  # `colcon build --symlink-install` runs a link to this file
NODES = (
    'simulator_node',
    'encoder_node',
    'controller_node',
    'recorder_node',
    'player_node',
    'markers_node',
    'viewer_node',
    'launcher',
)


def wheels_of_ros(distribution):
    """List what the nodes and their tests need of ROS 2, where none is sourced."""
    names = ('rclpy', 'common-interfaces', 'lifecycle-msgs', 'rmw-fastrtps-cpp', 'rosgraph-msgs')
    return [
        *(f'ros-{distribution}-{name}' for name in names),
        'ros-domain-coordinator',  # of the tests; here as every wheel of ROS
    ]


def share_files():
    """List every file of config/ with the folder below share/ that it installs to."""
    share = Path('share') / PACKAGE
    folders = {}
    for path in sorted(Path('config').rglob('*')):
        if path.is_file():
            folders.setdefault(str(share / path.parent), []).append(str(path))
    return list(folders.items())


setup(
    name=PACKAGE,
    version='0.1.0',
    description='Latent control of high-dimensional mechanical systems, on ROS 2',
    long_description=(ROOT / 'README.md').read_text(),
    long_description_content_type='text/markdown',
    maintainer='dpc_ros maintainers',
    maintainer_email='maintainers@dpc-ros.org',
    license='Apache-2.0',
    python_requires='>=3.10',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={
        PACKAGE: [
            '*/__init__.pyi',  # lazy_loader reads them
            *(f'view/*.{kind}' for kind in ('css', 'html', 'js')),  # the page of a run
        ]
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        *share_files(),
    ],
    install_requires=[
        'jaxtyping',
        'lazy_loader',
        'matplotlib',
        'mcap',
        'mcap-ros2-support',
        'numba',
        'numpy',
        'plotly',
        'pyyaml',
        'safetensors',
        'scipy',
        'threadpoolctl',
        'torch',
        'tqdm',
        'zstandard',
    ],
    extras_require={
        'ros': wheels_of_ros('jazzy'),
        'ros-kilted': wheels_of_ros('kilted'),
        'parquet': ['pyarrow'],
        'selection': ['ray[tune]'],
        'viewer': ['viser'],
        'test': [
            'beartype',
            'catkin_pkg',
            'colcon-common-extensions',
            'colcon-ros',
            'hypothesis',
            'mujoco',
            'mypy',
            'playwright',
            'psutil',
            'pyarrow',
            'pytest',
            'pytest-timeout',
            'pytest-xdist',
            'ray[tune]',
            'rosbags',
            'ruff',
            'torch_geometric',
            'viser',
        ],
    },
    entry_points={
        'console_scripts': [
            'dpc = dpc_ros.cli:main',
            *(f'{node} = {PACKAGE}.nodes.program:{node}' for node in NODES),
        ],
    },
    zip_safe=False,
)
