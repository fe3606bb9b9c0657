"""Know the face again after it was lost, and know what surely is not the face."""

from __future__ import annotations

from homography_servo.tracking.background import Background
from homography_servo.tracking.looks import Looks
import numpy as np


class Recognition:
    """
    Remembers the face and what is behind it.

    A rectangle that looks like the face in the proportions is not enough once the face
    has been seen: it must look like the face did, and must not have been in its place
    already while the face was followed elsewhere.

    Parameters
    ----------
    turns : tuple of int
        By how many places the corners may be rolled for the outline to look the same.

    """

    def __init__(self, turns: tuple[int, ...]) -> None:
        self._turns = turns
        self._looks, self._background = Looks(), Background()
        self._light_since = 1.0  # from when the looks were taken in to the background's picture

    def remember(self, image: np.ndarray, corners_px: np.ndarray, silhouette_px: np.ndarray,
                 clear: bool) -> None:
        """
        Take in a picture in which the face is followed.

        Parameters
        ----------
        image : (H, W) uint8 array
            The picture.
        corners_px : (4, 2) array
            Where the face is.
        silhouette_px : (M, 2) array
            Points between which the whole object is.
        clear : bool
            Whether all of its sides are in view; what hides one is not its looks.

        """
        if clear or not self._looks.known:
            self._looks.remember(image, corners_px)
            self._light_since = 1.0
        else:
            self._light_since *= self._background.light(image)
        self._background.remember(image, silhouette_px)

    def doubt(self, image: np.ndarray, corners_px: np.ndarray) -> str:
        """Say why what has these corners (4, 2) is not the face; empty if it may be."""
        if self.behind(image, corners_px):
            return 'what is found was there already while the face was elsewhere ' \
                '(a reset forgets that)'
        return self._looks.doubt(image, corners_px, self._turns,
                                 self._light_since * self._background.light(image))

    def news(self, image: np.ndarray) -> np.ndarray | None:
        """Mark in a small picture (H / 2, W / 2) what is no known background, if that is known."""
        return self._background.news(image)

    def behind(self, image: np.ndarray, corners_px: np.ndarray) -> bool:
        """Tell whether what has these corners (4, 2) is a part of the background."""
        return self._background.shows(image, corners_px)

    def turn(self, image: np.ndarray, corners_px: np.ndarray) -> int:
        """Say by how many places to roll the corners (4, 2), if its print tells."""
        return self._looks.best_turn(image, corners_px, self._turns)
