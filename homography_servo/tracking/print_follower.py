"""Follow a face by the print on it where its edges are too weak."""

from __future__ import annotations

from homography_servo.result import Rejected
from homography_servo.tracking.doubts import FaceCheck
from homography_servo.tracking.doubts import surprise
from homography_servo.tracking.doubts import vagueness
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Look
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.quality import SEEN_SIDE
from homography_servo.tracking.quality import SIDES_NEEDED
from homography_servo.tracking.snake import fit_snake
from homography_servo.tracking.texture import FaceTexture
from homography_servo.tracking.tracker_settings import POLARITIES
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np

CLICK_SIGMA_PX = 1.0  # of corners that a person points at
TOLD_PX = 4.0  # how far from given corners weak edges may lie


class PrintFollower:
    """
    Remembers the print of a face, and fits its outline with the help of it.

    Parameters
    ----------
    plane : Plane
        Straightens the lens.
    face : FaceCheck
        Knows what can be the face.

    """

    def __init__(self, plane: Plane, face: FaceCheck) -> None:
        self._plane, self._face, self._texture = plane, face, FaceTexture()
        self.needed = False  # whether the edges alone are too weak

    @property
    def known(self) -> bool:
        """Tell whether there is print to go by."""
        return self._texture.known

    def remember(self, image: np.ndarray, corners: np.ndarray) -> None:
        """Take in the print of a face with these corners, if there is any."""
        self._texture.remember(image, self._plane.to_image(corners))

    def begin(self, image: np.ndarray, prior: Prior, blur_px: float,
              settings: TrackerSettings) -> SnakeFit | Rejected:
        """Accept weak edges around given corners where there is print to go on with."""
        clicked = Prior(prior.corners, np.eye(8) / CLICK_SIGMA_PX ** 2)
        fit = fit_snake(image, prior.corners, Look(blur_px, settings.edge_half_px), self._plane,
                        clicked, POLARITIES[settings.polarity])
        if isinstance(fit, Rejected):
            return fit
        self.remember(image, fit.corners)
        moved_px = float(np.abs(fit.corners - prior.corners).max())
        if not self.known or moved_px > TOLD_PX \
                or np.count_nonzero(fit.judged.side_share > 2.0 * SEEN_SIDE) < SIDES_NEEDED - 1:
            self._texture.forget()
            self.needed = False
            return Rejected('neither edges nor print confirm the given corners')
        self.needed = True
        return fit

    def fit(self, image: np.ndarray, corners: np.ndarray, expected: Prior, blur_px: float,
            settings: TrackerSettings, following: bool) -> SnakeFit | Rejected:
        """
        Fit the outline to the print on the face, and to its edges where they show.

        Parameters
        ----------
        image : (H, W) uint8 array
            The picture.
        corners : (4, 2) array
            Where to begin.
        expected : Prior
            Where the corners must be by now.
        blur_px : float
            Of the edges.
        settings : TrackerSettings
            What may happen.
        following : bool
            Whether the prior comes from the motion.

        Returns
        -------
        SnakeFit or Rejected

        """
        found = self._texture.align(image, self._plane.to_image(corners))
        if found is None:
            return Rejected('the face does not look as before')
        prior = Prior(self._plane.from_image(found.corners), found.information)
        look = Look(blur_px, settings.edge_half_px, least=0, first_sure_px=0.15)
        fit = fit_snake(image, prior.corners, look, self._plane, prior,
                        POLARITIES[settings.polarity])
        if isinstance(fit, Rejected):
            return fit
        doubt = surprise(fit, expected, settings, following) \
            or self._face.doubt(fit.corners, settings) or vagueness(fit, settings)
        return Rejected(doubt) if doubt else fit._replace(by_print=True)
