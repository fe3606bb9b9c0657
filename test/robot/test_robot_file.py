"""The robot file: what is read, what is refused and where, and that it can be written again."""

import dataclasses
import re

from arm_setup import arm
from arm_setup import DEFAULT
from arm_setup import default_robot
from arm_setup import joint
from homography_servo.errors import ConfigError
from homography_servo.robot.robot_file import dump_robot
from homography_servo.robot.robot_file import load_robot
from homography_servo.robot.robot_file import save_robot
import numpy as np
import pytest

# The height of the box is a matter of taste; the rest is what the tests change.
TEXT = re.sub('box_height_m: .*', 'box_height_m: 0.03', DEFAULT.read_text())


def line_of(text: str, part: str) -> int:
    return 1 + text[:text.index(part)].count('\n')


def refused(tmp_path, text) -> ConfigError:
    path = tmp_path / 'arm.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_robot(path)
    assert str(caught.value).startswith(f'{path}:{caught.value.line}: ')
    return caught.value


def test_default_robot_is_the_one_of_the_table():
    robot = default_robot()
    rows = [[j.theta0_rad, j.d_m, j.a_m, j.alpha_rad] for j in robot.joints]
    deg = np.pi / 180
    np.testing.assert_allclose(rows, [
        [0, 0.164, 0.093, 0], [0, 0, 0.092, 90 * deg], [0, 0, 0.057, 0],
        [90 * deg, 0, 0, 90 * deg], [90 * deg, 0.1, 0, 90 * deg], [90 * deg, 0.03, 0, 0]])
    np.testing.assert_allclose(np.rad2deg(robot.lower_rad), [-80, -80, -80, -85, -75, -80])
    np.testing.assert_allclose(np.rad2deg(robot.upper_rad), [80, 75, 85, 85, 75, 80])
    np.testing.assert_allclose(np.deg2rad(robot.units_per_rad),
                               [17.50, 18.06, 16.97, 16.47, 18.67, 17.50])
    assert robot.joint_names == tuple(f'joint{i}' for i in range(1, 7))
    assert robot.home_from_base[2, 3] == pytest.approx(0.95 - robot.home_depth_m)
    np.testing.assert_allclose(robot.object_points_m[:, :2],
                               [[-.05, -.03], [.05, -.03], [.05, .03], [-.05, .03]])


@pytest.mark.parametrize('old, new, key, reason', [
    ('home_depth_m: 1.0', 'home_depth_m: -1.0', 'home_depth_m', 'must be in'),
    ('home_depth_m: 1.0', 'home_depth_m: 010', 'home_depth_m', 'plain decimal'),
    ('home_depth_m: 1.0', 'home_depth_m: 1:30', 'home_depth_m', 'plain decimal'),
    ('home_depth_m: 1.0', 'home_depth_m: no', 'home_depth_m', 'plain decimal'),
    ('home_depth_m: 1.0', 'home_depth_m: 0x10', 'home_depth_m', 'plain decimal'),
    ('home_depth_m: 1.0', 'home_depth_m: 1_0', 'home_depth_m', 'plain decimal'),
    ('home_depth_m: 1.0', 'home_depth_m: .inf', 'home_depth_m', 'plain decimal'),
    ('home_depth_m: 1.0', 'home_depth_m: .nan', 'home_depth_m', 'plain decimal'),
    ('home_depth_m: 1.0', 'home_depth_m: 1e999', 'home_depth_m', 'finite'),
    ('home_depth_m: 1.0', 'home_depth_m: "1.0"', 'home_depth_m', 'without quotes'),
    ('home_depth_m: 1.0', 'home_depth_m:', 'home_depth_m', "got nothing|got ''"),
    ('home_depth_m: 1.0', 'home_depth_m: [1.0]', 'home_depth_m', 'got a list'),
    ('home_depth_m: 1.0', 'home_depth: 1.0', 'home_depth', 'unknown key'),
    ('box_height_m: 0.03', 'box_height_m: -0.03', 'object.box_height_m', 'must be in'),
    ('box_height_m: 0.03', 'face_size_m: [1, 1]', 'object.face_size_m', 'given twice'),
    ('[0.10, 0.06]', '[0.10]', 'object.face_size_m', 'must have 2 items, got 1'),
    ('[0.10, 0.06]', '[0.10, 0]', 'object.face_size_m[1]', 'must be in'),
    ('name: robix_rcs6', 'name: no', 'name', 'put it in quotes'),
    ('name: robix_rcs6', 'name: 12', 'name', 'put it in quotes'),
    ('lower_deg: -75', 'lower_deg: 80', 'joints[4].upper_deg', 'above lower_deg'),
    ('velocity_deg_s: 90', 'velocity_deg_s: 0', 'joints[0].velocity_deg_s', 'must be in'),
    ('channel: 3', 'channel: 2', 'joints[2]', 'repeats joint2 on channel 2'),
    ('name: joint3', 'name: joint2', 'joints[2]', 'repeats joint2'),
    ('channel: 3', 'channel: 3.5', 'joints[2].servo.channel', 'whole number'),
    ('channel: 3', 'channel: 0', 'joints[2].servo.channel', 'must be in'),
    ('sign: 1, zero_units: 0}', 'sign: 0, zero_units: 0}', 'joints[0].servo.sign', '1 or -1'),
    ('units_per_deg: 16.97', 'units_per_deg: 30', 'joints[2].servo.units_per_deg',
     'the servo can be set to'),
    ('[0, -1, 0]', '[0, 1, 0]', 'home_from_base.rotation', 'must hold a rotation'),
    ('[0, -1, 0]', '[0, -1, 0.1]', 'home_from_base.rotation', 'must hold a rotation'),
])
def test_what_is_wrong_is_named_with_its_line(tmp_path, old, new, key, reason):
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    error = refused(tmp_path, text)
    assert error.key == key
    assert re.search(reason, error.reason)
    if not key.endswith(']') and '.upper' not in key and 'rotation' not in key:
        assert error.line == line_of(text, new)


def test_missing_keys_are_found_at_every_level(tmp_path):
    for part, key in (('alpha_deg: 0', 'alpha_deg'), ('sign: 1, ', 'sign')):
        assert f'{key!r} is missing' in refused(tmp_path, TEXT.replace(part, '', 1)).reason
    assert "'joints' is missing" in refused(tmp_path, TEXT[:TEXT.index('joints:')]).reason
    shortened = TEXT[:TEXT.index('joints:')] + 'joints: []\n'
    assert 'at least one joint' in refused(tmp_path, shortened).reason


@pytest.mark.parametrize('text, reason', [
    ('', 'is empty'),
    ('# nothing\n', 'is empty'),
    ('- 1\n- 2\n', 'must hold the keys'),
    ('a: [1, 2\n', 'not valid YAML'),
    ('a: b: c\n', 'not valid YAML'),
    ('? [1, 2]\n: 3\n', 'unknown key'),
    ('[' * 5000, 'nested too deeply|not valid YAML'),
    ('name: a\n---\nname: b\n', 'not valid YAML'),
    ('# much\n' * 200_000, 'is larger than 1000000 characters'),
])
def test_what_is_no_robot_file(tmp_path, text, reason):
    assert re.search(reason, refused(tmp_path, text).reason)


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match='cannot be read: No such file'):
        load_robot(tmp_path / 'none.yaml')
    with pytest.raises(ConfigError, match='cannot be read: Is a directory'):
        load_robot(tmp_path)
    (tmp_path / 'bytes.yaml').write_bytes(b'name: \xff\xfe\n')
    with pytest.raises(ConfigError, match='cannot be read'):
        load_robot(tmp_path / 'bytes.yaml')


def test_numbers_may_be_written_in_any_plain_way(tmp_path):
    path = tmp_path / 'arm.yaml'
    path.write_text(TEXT.replace('d_m: 0.164', 'd_m: 1.64e-1').replace('0.093', '+.093'))
    robot = load_robot(path)
    assert (robot.joints[0].d_m, robot.joints[0].a_m) == (0.164, 0.093)


def test_any_cut_of_the_file_is_refused_or_a_robot(tmp_path):
    path = tmp_path / 'arm.yaml'
    read = 0
    for end in range(0, len(TEXT), 97):
        path.write_text(TEXT[:end])
        try:
            read += load_robot(path).count > 0
        except ConfigError as error:
            assert error.reason
    assert read <= 30  # only cuts after a whole joint


def same(a, b) -> bool:
    near = all(np.allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-11)
               for name in ('home_from_base', 'tool_from_object', 'object_points_m',
                            'lower_rad', 'upper_rad', 'units_per_rad', 'velocity_rad_s'))
    rows = [np.allclose([j.theta0_rad, j.d_m, j.a_m, j.alpha_rad, j.zero_units],
                        [k.theta0_rad, k.d_m, k.a_m, k.alpha_rad, k.zero_units],
                        rtol=0, atol=1e-11) for j, k in zip(a.joints, b.joints)]
    return near and all(rows) and a.joint_names == b.joint_names and a.name == b.name


def test_a_saved_robot_is_read_as_the_same(tmp_path):
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    transform = np.eye(4)
    transform[:3, :3] = turn * np.linalg.det(turn)
    transform[:3, 3] = rng.normal(size=3)
    robot = dataclasses.replace(default_robot(), name='other: "arm" \\ é # no',
                                home_from_base=transform, face_size_m=(0.07, 0.04),
                                object_points_m=rng.normal(size=(7, 3)))
    path = tmp_path / 'arm.yaml'
    save_robot(path, robot, 'Calibrated.\nTwo lines.')
    assert same(load_robot(path), robot)
    assert path.read_text().startswith('# Calibrated.\n# Two lines.\n')
    assert dump_robot(robot, 'Calibrated.\nTwo lines.') == path.read_text()
    assert [p.name for p in tmp_path.iterdir()] == ['arm.yaml']


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path):
    with pytest.raises(OSError):
        save_robot(tmp_path / 'none' / 'arm.yaml', default_robot())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('changes, reason', [
    ({'lower_rad': 1.4}, 'upper_rad must be above'),
    ({'d_m': float('nan')}, 'd_m must be finite'),
    ({'velocity_rad_s': 0.0}, 'velocity_rad_s must be above 0'),
    ({'units_per_rad': -5.0}, 'units_per_rad must be above 0'),
    ({'sign': 2}, 'sign must be 1 or -1'),
    ({'zero_units': 1500.0}, 'the servo can be set to'),
])
def test_a_joint_refuses_nonsense(changes, reason):
    with pytest.raises(ValueError, match=reason):
        joint(**changes)


@pytest.mark.parametrize('changes, reason', [
    ({'joints': ()}, 'at least one joint'),
    ({'joints': (joint(), joint())}, 'its own name'),
    ({'joints': (joint(), joint('joint2'))}, 'its own channel'),
    ({'home_depth_m': 0.0}, 'home_depth_m must be above 0'),
    ({'home_from_base': np.eye(3)}, r'shape \(4, 4\)'),
    ({'home_from_base': np.diag([1.0, 1.0, -1.0, 1.0])}, 'must hold a rotation'),
    ({'tool_from_object': np.eye(4) + np.eye(4)[:, ::-1]}, 'must hold a rotation'),
    ({'tool_from_object': np.full((4, 4), np.nan)}, 'must be finite'),
    ({'tool_from_object': np.vstack([np.eye(4)[:3], [0, 0, 1, 1]])}, 'row 0 0 0 1'),
    ({'face_size_m': (0.1, 0.0)}, 'two lengths above 0'),
    ({'box_height_m': -0.1}, '0 or above'),
    ({'object_points_m': np.zeros((3, 3))}, r'N >= 4'),
    ({'object_points_m': np.full((4, 3), np.inf)}, 'must be finite'),
])
def test_a_robot_refuses_nonsense(changes, reason):
    with pytest.raises(ValueError, match=reason):
        arm([(0, 0.1, 0.2, 0)], **changes)


def test_what_a_robot_holds_cannot_be_changed():
    robot = default_robot()
    with pytest.raises(ValueError, match='read-only'):
        robot.home_from_base[0, 3] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        robot.name = 'other'
