"""Cameras, motions and pictures that the tests of the tracker share."""

from dataclasses import replace
import math

from homography_servo.geometry.camera import Camera
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
from homography_servo.tracking.tracker import Tracker
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np
from scipy.spatial.transform import Rotation

CAMERA = Camera(800.0, 800.0, 319.5, 239.5, 640, 480)
BENT = replace(CAMERA, distortion_model='plumb_bob', distortion=(-0.25, 0.0, 0.0, 0.0, 0.0))
FACE_M = (0.10, 0.06)
RATE_HZ = 30.0
SQUARE = np.array([[100.0, 100.0], [200.0, 100.0], [200.0, 160.0], [100.0, 160.0]])


def pose(x=0.0, y=0.0, z=0.75, tilt_x=0.0, tilt_y=0.0, turn=0.0):
    """Place the box in front of the camera; angles in degrees."""
    camera_from_object = np.eye(4)
    camera_from_object[:3, :3] = Rotation.from_euler(
        'xyz', [tilt_x, tilt_y, turn], degrees=True).as_matrix()
    camera_from_object[:3, 3] = x, y, z
    return camera_from_object


def swing(index, tilt=15.0, turn=20.0, reach_m=0.05):
    """Move the box smoothly: camera_from_object of picture `index`."""
    phase = 2.0 * math.pi * index / 120.0
    return pose(reach_m * math.sin(phase), 0.6 * reach_m * math.cos(1.3 * phase),
                0.75 + 0.05 * math.sin(0.7 * phase), tilt * math.sin(1.1 * phase + 0.5),
                tilt * math.cos(0.9 * phase), 11.0 + turn * math.sin(0.6 * phase))


def told(corners_px, **settings):
    """Make settings for a tracker that is told where the face is."""
    return TrackerSettings(initial_corners_px=tuple(float(v) for v in np.ravel(corners_px)),
                           **settings)


class Show:
    """Shows a moving box to a tracker that begins at the true corners."""

    def __init__(self, scene=SceneSettings(), height_m=0.0, camera=CAMERA, seed=0, motion=swing,
                 **settings):
        self.scene = Scene(camera, FACE_M, height_m, scene, seed)
        self.motion = motion
        self.tracker = Tracker(FACE_M, told(self.scene.corners(motion(0)), **settings), camera,
                               height_m)
        self.tracks, self.truths = [], []

    def frame(self, index, present=True):
        """Render one picture."""
        return self.scene.render(self.motion(index) if present else None, index / RATE_HZ, index)

    def run(self, count):
        """Show pictures; give the states."""
        for index in range(count):
            frame = self.frame(index)
            self.tracks.append(self.tracker.update(frame.image_grey, index / RATE_HZ))
            self.truths.append(frame.true_corners_px)
        return [track.state for track in self.tracks]

    def errors(self):
        """Give the distances (frames, 4) of trusted corners from the truth [px]."""
        return np.array([np.linalg.norm(track.corners_px - truth, axis=1)
                         for track, truth in zip(self.tracks, self.truths)
                         if track.corners_px is not None and truth is not None])
