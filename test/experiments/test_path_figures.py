"""Figure 1: both paths agree, for both displacements, and the files say so."""

import json

from homography_servo.experiments import path_figures
from homography_servo.geometry.decomposition import parameters_from_pose
import numpy as np
import pytest


@pytest.mark.parametrize('displacement', path_figures.DISPLACEMENTS, ids=lambda d: d.title)
@pytest.mark.parametrize('count', [2, 13, 200])
def test_both_paths_agree_to_a_billionth_of_a_pixel(displacement, count):
    result = path_figures.compute(displacement, count)
    assert result['largest_distance_px'] <= 1e-9
    assert result['all_in_view']
    assert result['projected_px'].shape == result['image_px'].shape == (count, 4, 2)


def test_the_displacements_are_those_of_the_paper():
    half_turn, tilted = (path_figures.compute(each, 13) for each in path_figures.DISPLACEMENTS)
    for result, turn_deg, still in ((half_turn, 180.0, 1), (tilted, 60.0, 2)):
        parameters = parameters_from_pose(result['poses'])
        turned = np.degrees(np.unwrap(parameters.gamma))
        assert turned[-1] - turned[0] == pytest.approx(turn_deg)
        moved = np.abs(result['poses'][-1, :3, 3] - result['poses'][0, :3, 3])
        assert moved[still] == pytest.approx(0.0) and (np.delete(moved, still) > 0.05).all()
    # Tilted: no pose is in the plane of P_0.
    assert (tilted['poses'][:, 2, 2] < 0.95).all()


def test_interpolating_depth_itself_would_not_agree():
    result = path_figures.compute(path_figures.DISPLACEMENTS[0], 13)
    assert result['distance_px_if_depth_were_linear'] > 0.5


def test_the_path_in_the_image_never_sees_a_pose():
    shift_px = np.array([25.0, -10.0])
    home_px = path_figures.project(np.eye(4))
    path_px = path_figures.path_in_image(home_px, home_px, home_px + shift_px, 5)
    assert path_px[2] == pytest.approx(home_px + 0.5 * shift_px)


def test_it_writes_a_picture_and_the_numbers(tmp_path, capsys):
    pytest.importorskip('matplotlib')
    assert path_figures.main(['--output', str(tmp_path / 'new'), '--count', '7']) == 0
    numbers = json.loads((tmp_path / 'new' / 'path_figures.json').read_text())
    assert numbers['largest_distance_px'] <= 1e-9
    assert [len(each['poses']) for each in numbers['displacements']] == [7, 7]
    assert (tmp_path / 'new' / 'path_figures.png').read_bytes()[:4] == b'\x89PNG'
    assert 'px apart at most' in capsys.readouterr().out


def test_disagreement_is_a_failure(tmp_path, monkeypatch, capsys):
    pytest.importorskip('matplotlib')
    exact = path_figures.path_in_image
    monkeypatch.setattr(path_figures, 'path_in_image', lambda *views: exact(*views) + 1e-6)
    assert path_figures.main(['--output', str(tmp_path)]) == 1
    assert 'differ by more than' in capsys.readouterr().err


@pytest.mark.parametrize('arguments', [['--count', '1'], ['--count', 'many'], ['--colour']])
def test_bad_arguments_exit_with_2(arguments):
    with pytest.raises(SystemExit) as caught:
        path_figures.main(arguments)
    assert caught.value.code == 2
