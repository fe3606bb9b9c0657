"""Sequences with exact truth for the tracker benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field
import math
from typing import Callable, Iterator

from homography_servo.geometry.camera import Camera
from homography_servo.simulation.scene import Frame
from homography_servo.simulation.scene import Scene
from homography_servo.simulation.scene_settings import SceneSettings
import numpy as np
from scipy.spatial.transform import Rotation

FACE_M = (0.10, 0.06)
RATE_HZ = 30.0
FOCAL_PX = 800.0
CAMERA = Camera(FOCAL_PX, FOCAL_PX, 319.5, 239.5, 640, 480)
BENT = Camera(FOCAL_PX, FOCAL_PX, 319.5, 239.5, 640, 480, 'plumb_bob',
              (-0.25, 0.0, 0.0, 0.0, 0.0))
DEPTH_M = 0.75


@dataclass(frozen=True)
class Motion:
    """A smooth motion by a few sines; amplitudes and the peak speed of the centre."""

    speed_px: float = 3.0  # per frame
    tilt_deg: float = 15.0
    turn_deg: float = 20.0
    scale: float = 0.1
    spin_deg: float = 0.0  # per frame, steadily
    slowness: float = 1.0

    def pose(self, time_s: float) -> np.ndarray:
        """Give camera_from_object (4, 4)."""
        rate = 2.0 * math.pi / 4.0 / self.slowness
        # 0.8 and 0.6 of it at right angles and out of step: speed_px is the fastest.
        reach_m = self.speed_px * RATE_HZ / rate / FOCAL_PX * DEPTH_M
        x_m, y_m = 0.8 * reach_m * math.sin(rate * time_s), 0.6 * reach_m * math.sin(
            rate * time_s + 0.4)
        depth_m = DEPTH_M * (1.0 + self.scale * math.sin(0.7 * rate * time_s))
        angles = (self.tilt_deg * math.sin(1.1 * rate * time_s + 0.5),
                  self.tilt_deg * math.cos(0.9 * rate * time_s),
                  self.turn_deg * math.sin(0.6 * rate * time_s)
                  + self.spin_deg * RATE_HZ * time_s)
        camera_from_object = np.eye(4)
        camera_from_object[:3, :3] = Rotation.from_euler('xyz', angles, degrees=True).as_matrix()
        camera_from_object[:3, 3] = x_m, y_m, depth_m
        return camera_from_object


@dataclass(frozen=True)
class Case:
    """One sequence."""

    name: str
    scene: SceneSettings = field(default_factory=SceneSettings)
    motion: Motion = Motion()
    height_m: float = 0.0
    camera: Camera = CAMERA
    hidden: Callable[[int], bool] = lambda index: False  # frames in which a part is covered
    hidden_corners: tuple[int, ...] = ()

    def frames(self, count: int, seed: int) -> Iterator[tuple[int, float, np.ndarray, Frame]]:
        """Render one frame after the other: index, time, camera_from_object, frame."""
        scene = self.make_scene(seed)
        for index in range(count):
            time_s = index / RATE_HZ
            camera_from_object = self.motion.pose(time_s)
            yield index, time_s, camera_from_object, scene.render(camera_from_object, time_s,
                                                                  index)

    def make_scene(self, seed: int) -> Scene:
        """Make the world of this sequence."""
        return Scene(self.camera, FACE_M, self.height_m, self.scene, seed)


def _between(first: int, last: int) -> Callable[[int], bool]:
    return lambda index: first <= index < last


BOX_M = 0.04
# Wide turns and tilts, slowly, so that each side of the box appears and vanishes.
ROUND_TRIP = Motion(speed_px=3.0, tilt_deg=35.0, turn_deg=60.0)
HIDDEN = {'occluder_start_s': 1.0, 'occluder_duration_s': 20.0 / RATE_HZ, 'noise_grey': 5.0}
# Long enough to take something else of its proportions for the face.
GONE = {'noise_grey': 5.0, 'clutter': 1.0, 'vanish_start_s': 2.0, 'vanish_duration_s': 3.0}
CASES = (
    *(Case(f'plain noise {noise}', SceneSettings(noise_grey=float(noise)))
      for noise in (2, 5, 10)),
    Case('plain blur 2 px', SceneSettings(noise_grey=5.0, blur_px=2.0)),
    *(Case(f'plain speed {speed:.0f} px', SceneSettings(noise_grey=5.0),
           Motion(speed_px=speed, slowness=0.4)) for speed in (13.0, 20.0)),
    Case('plain rotation', SceneSettings(noise_grey=5.0), Motion(turn_deg=0.0, spin_deg=4.0)),
    Case('plain tilt 50', SceneSettings(noise_grey=5.0), Motion(tilt_deg=50.0)),
    Case('plain scale', SceneSettings(noise_grey=5.0), Motion(scale=0.35)),
    Case('gradient and flicker', SceneSettings(noise_grey=5.0, gradient=0.5, flicker=0.1)),
    Case('print', SceneSettings(noise_grey=5.0, print_contrast=100.0)),
    Case('clutter', SceneSettings(noise_grey=5.0, clutter=1.0, texture_grey=5.0)),
    Case('hidden corner', SceneSettings(occluder='corner', occluder_index=1, **HIDDEN),
         hidden=_between(30, 50), hidden_corners=(1,)),
    Case('hidden side', SceneSettings(occluder='side', occluder_index=2, **HIDDEN),
         hidden=_between(30, 50), hidden_corners=(2, 3)),
    Case('box', SceneSettings(noise_grey=5.0, shadow=0.5), ROUND_TRIP, BOX_M),
    Case('box tilt 45', SceneSettings(noise_grey=5.0, shadow=0.5),
         Motion(tilt_deg=45.0, turn_deg=180.0), BOX_M),
    Case('box clutter', SceneSettings(noise_grey=5.0, shadow=0.5, clutter=1.0), ROUND_TRIP,
         BOX_M),
    Case('distorted lens', SceneSettings(noise_grey=5.0), Motion(speed_px=5.0), 0.0, BENT),
    Case('distorted lens, box', SceneSettings(noise_grey=5.0, shadow=0.5),
         Motion(speed_px=5.0, tilt_deg=30.0), BOX_M, BENT),
    Case('vanish', SceneSettings(noise_grey=5.0, vanish_start_s=2.0, vanish_duration_s=0.6)),
    Case('vanish in clutter', SceneSettings(**GONE)),
    Case('vanish in clutter, print', SceneSettings(print_contrast=100.0, **GONE)),
    Case('vanish in clutter, box', SceneSettings(shadow=0.5, **GONE), height_m=BOX_M),
)


def random_view(rng: np.random.Generator) -> np.ndarray:
    """Place the box somewhere wholly in view: camera_from_object (4, 4)."""
    while True:
        camera_from_object = np.eye(4)
        angles = (*rng.uniform(-45.0, 45.0, 2), rng.uniform(-180.0, 180.0))
        camera_from_object[:3, :3] = Rotation.from_euler('xyz', angles, degrees=True).as_matrix()
        camera_from_object[:3, 3] = *rng.uniform(-0.3, 0.3, 2), rng.uniform(0.55, 1.1)
        half = np.array(FACE_M) / 2.0
        corners_m = np.array([(x, y, 0.0) for x in (-half[0], half[0])
                              for y in (-half[1], half[1])])
        points_m = corners_m @ camera_from_object[:3, :3].T + camera_from_object[:3, 3]
        facing = camera_from_object[:3, 2] @ camera_from_object[:3, 3] \
            / np.linalg.norm(camera_from_object[:3, 3])
        if CAMERA.contains(CAMERA.project(points_m), 12.0).all() and facing > 0.5:
            return camera_from_object
