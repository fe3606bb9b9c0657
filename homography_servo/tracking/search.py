"""Look for a face that is not followed, and be content with nothing else."""

from __future__ import annotations

from homography_servo.result import Rejected
from homography_servo.tracking.finder import find_face
from homography_servo.tracking.follower import Follower
from homography_servo.tracking.follower import GIVEN_SHAPE_SIGMA_PX
from homography_servo.tracking.motion import shape_prior
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.recognition import Recognition
from homography_servo.tracking.target import rolled
from homography_servo.tracking.target import Target
import numpy as np

ASIDE = 0.5  # of its longest side: how far from where a person says the face may be


class Search:
    """
    Looks for the face in one picture.

    Parameters
    ----------
    image : (H, W) uint8 array
        The picture.
    follower : Follower
        Fits outlines, and will follow what is found.
    recognition : Recognition
        Remembers the face if it has been seen before.
    plane : Plane
        Straightens the lens.
    told_px : (4, 2) array or None
        Where a person says the face is: what is found elsewhere is another thing.

    """

    def __init__(self, image: np.ndarray, follower: Follower, recognition: Recognition,
                 plane: Plane, told_px: np.ndarray | None) -> None:
        self._image, self._follower, self._plane = image, follower, plane
        self._recognition, self._told_px = recognition, told_px
        self.doubts: list[str] = []  # of what could have been the face but for its looks or place

    def near(self, corners_px: np.ndarray, told: bool) -> SnakeFit | Rejected:
        """
        Look around corners that are known to some pixels.

        Parameters
        ----------
        corners_px : (4, 2) array
            Where they are thought to be.
        told : bool
            Whether a person says so.

        Returns
        -------
        SnakeFit or Rejected

        """
        prior = shape_prior(self._plane.from_image(corners_px), GIVEN_SHAPE_SIGMA_PX)
        return self._recognised(self._follower.capture(self._image, prior, told=told))

    def anywhere(self, target: Target, expected_px: np.ndarray | None,
                 only_news: bool) -> SnakeFit | Rejected:
        """
        Look in the whole picture.

        Parameters
        ----------
        target : Target
            The face and where it may be.
        expected_px : (4, 2) array or None
            Corners that say which one comes first.
        only_news : bool
            Whether to leave out the background as far as it is known.

        Returns
        -------
        SnakeFit or Rejected

        """
        expected = None if expected_px is None else self._plane.from_image(expected_px)
        news = self._recognition.news(self._image) if only_news else None
        found = find_face(self._image, target._replace(news=news, doubt=self._doubt),
                          self._plane, expected)
        if isinstance(found, Rejected):
            return found
        return self._recognised(self._follower.settle(self._image, found.fit))

    def _recognised(self, fit: SnakeFit | Rejected) -> SnakeFit | Rejected:
        """Refuse another thing, and begin with the corner that the print says is the first."""
        if isinstance(fit, Rejected):
            return fit
        doubt = self._doubt(fit.corners)
        if doubt:
            return Rejected(doubt)
        return rolled(fit, self._recognition.turn(self._image, self._plane.to_image(fit.corners)))

    def _doubt(self, corners: np.ndarray) -> str:
        """Say why what has these corners in the plane is another thing, if it is."""
        corners_px = self._plane.to_image(corners)
        doubt = self._elsewhere(corners_px) or self._recognition.doubt(self._image, corners_px)
        if doubt:
            self.doubts.append(doubt)
        return doubt

    def _elsewhere(self, corners_px: np.ndarray) -> str:
        if self._told_px is None:
            return ''
        away_px = float(np.linalg.norm((corners_px - self._told_px).mean(axis=0)))
        sides_px = np.linalg.norm(np.roll(self._told_px, -1, axis=0) - self._told_px, axis=1)
        return '' if away_px < ASIDE * sides_px.max() \
            else f'what is found is {away_px:.0f} px away from initial_corners_px'
