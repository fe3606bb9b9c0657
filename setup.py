from glob import glob

from setuptools import find_packages
from setuptools import setup

NAME = 'homography_servo'
NODES = ('snake_tracker', 'path_planner', 'visual_servo', 'robix_bridge', 'camera_sim',
         'video_camera', 'dashboard')
PROGRAMS = {
    'servo_chain': 'nodes.servo_chain',
    'robix_emulator': 'robot.emulator_main',
    'bringup': 'launch.bringup',
    'servo_trial': 'experiments.servo_trial',
    'path_figures': 'experiments.path_figures',
    'benchmark': 'experiments.benchmark',
}

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={f'{NAME}.nodes': ['web/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/*.*')),
        (f'share/{NAME}/config/robots', glob('config/robots/*')),
        (f'share/{NAME}/config/cameras', glob('config/cameras/*')),
        (f'share/{NAME}/launch', glob(f'{NAME}/launch/*.launch.py')),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='homography_servo maintainers',
    maintainer_email='maintainers@users.noreply.github.com',
    description='Visual servoing by homography decomposition, planned and checked before it moves',
    license='Apache-2.0',
    entry_points={'console_scripts': [
        *(f'{node} = {NAME}.nodes.{node}:main' for node in NODES),
        *(f'{name} = {NAME}.{module}:main' for name, module in PROGRAMS.items()),
    ]},
)
