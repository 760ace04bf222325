# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Installs by colcon (ament_python) and by pip; exact versions are in .ci/constraints.txt."""

from glob import glob

from setuptools import Extension, find_packages, setup

NAME = 'pendubot_identification'
SHARE = f'share/{NAME}'

NODES = ['bridge', 'recorder', 'player', 'identifier', 'exciter', 'balancer', 'tracker', 'virtual_board']

BAGS = [(f'{SHARE}/{folder}', sorted(glob(f'{folder}/*.*'))) for folder in ['bags', *sorted(glob('bags/*/'))]]


def kernel(name, *flags):
    """Return a kernel, which is omitted if it does not compile: numpy does the same.

    Without contraction, every processor rounds in the same way.
    """
    return Extension(
        f'{NAME}.{name}',
        [f'{NAME}/{source}.c' for source in ('model/rollout', 'model/filter', 'optimizers/mde')],
        extra_compile_args=[
            *('-std=gnu11', '-O3', '-ffp-contract=off', '-fno-math-errno', '-fno-trapping-math'),
            *('-fvisibility=hidden', '-Wno-psabi', *flags),
        ],
        depends=[f'{NAME}/model/motion.h'],
        libraries=['m'],
        optional=True,
    )


setup(
    name=NAME,
    version='1.0.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={
        NAME: ['py.typed', '__init__.pyi', 'report/*.*', 'report/uplot/*', 'studio/*.*'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (SHARE, ['package.xml']),
        (f'{SHARE}/config', sorted(glob('config/*.*'))),
        (f'{SHARE}/launch', sorted(glob('launch/*.launch.py'))),
        (f'{SHARE}/foxglove', sorted(glob('foxglove/*.*'))),
        (f'{SHARE}/examples', sorted(glob('examples/*.*'))),
        *BAGS,
    ],
    python_requires='>=3.10',
    install_requires=[
        'setuptools',
        'numpy>=1.26',
        'scipy>=1.11',
        'pyserial>=3.5',
        'mcap>=1.5',
        'rosbags>=0.11',
        'matplotlib>=3.6',
        'jinja2>=3.0',
        'markupsafe',
        'pydantic>=1.10,!=2.0.*,!=2.1.*,!=2.2.*,!=2.3.*,!=2.4.*,!=2.5.*',
        'PyYAML>=6.0',
        'tqdm>=4.66',
    ],
    extras_require={
        'ros': ['ros-rclpy[fastrtps]==7.1.6', 'ros-jazzy-rclpy', 'ros-jazzy-common-interfaces'],
        # Files of Excel and Parquet.
        'files': ['openpyxl', 'pandas', 'pyarrow'],
        # pendubot studio.
        'studio': ['aiohttp>=3.9'],
        # Completion in a shell.
        'completion': ['argcomplete'],
        # The HTML of docs/.
        'docs': ['myst-parser', 'sphinx'],
        # Peers of benchmarks/speed.
        'benchmark': ['mujoco[sysid]', 'pygmo'],
        # Peers of benchmarks.exports, and an example; 1 GB.
        'engines': ['casadi', 'drake', 'pin'],
        'test': [
            'aiohttp',
            'axe-playwright-python',
            'colcon-common-extensions',
            'hypothesis',
            'import-linter',
            'ipykernel',
            'mujoco',
            'mypy',
            'nbclient',
            'openpyxl',
            'pandas',
            'playwright',
            'pyarrow',
            'pytest',
            'pytest-cov',
            'pytest-timeout',
            'pytest-xdist',
            'ruff',
            'argcomplete',
            'swarmops',
            'sympy',
            'types-PyYAML',
            'urdf_parser_py',
        ],
    },
    ext_modules=[kernel('_kernel'), kernel('_kernel_avx512', '-march=x86-64-v4')],
    zip_safe=False,
    author='The pendubot_identification authors',
    maintainer='The pendubot_identification authors',
    maintainer_email='maintainers@pendubot-identification.invalid',
    description='Bridge, recorder and identifier for a pendubot: from the board to its parameters.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [f'{program} = {NAME}.programs:{program}' for program in ['pendubot', *NODES]],
    },
)
