"""Remember how the face looks, to know it again after it was lost."""

from __future__ import annotations

from homography_servo.tracking.rectified import rectified_view
import numpy as np

GRID = (24, 24)  # samples across and down; as many of both, so that views can be turned
INSET = 0.06  # of the face's width and height that is left out at its edges
PRINT_GREY = 8.0  # standard deviation of a view with print on it
LIKE = 0.6  # correlation of the print on the face with itself
EVEN_GREY, EVEN_SHARE = 12.0, 0.08  # by which one colour may vary, at least and of its level
EVEN = 0.75  # share of the samples that show the colour of a face without print
BRIGHTER = 1.5  # what a change of place or tilt may make of a grey level, and its inverse
DARK_GREY = 10.0  # added to levels before they are compared: near black they say little
FORGET = '(a reset forgets how it looked)'


class Looks:
    """Knows the face by its print, or by its one colour."""

    def __init__(self) -> None:
        self._view: np.ndarray | None = None

    @property
    def known(self) -> bool:
        """Tell whether the face has been seen."""
        return self._view is not None

    def remember(self, image: np.ndarray, corners_px: np.ndarray) -> None:
        """Take in the face with these corners (4, 2)."""
        self._view = rectified_view(image, corners_px, GRID, INSET)

    def doubt(self, image: np.ndarray, corners_px: np.ndarray, turns: tuple[int, ...],
              light: float = 1.0) -> str:
        """
        Say why a thing does not look like the face; empty if it does.

        Parameters
        ----------
        image : (H, W) uint8 array
            The picture.
        corners_px : (4, 2) array
            Of the thing.
        turns : tuple of int
            By how many places its corners may be rolled.
        light : float
            By which the whole picture has become brighter.

        """
        if self._view is None:
            return ''
        view = rectified_view(image, corners_px, GRID, INSET)
        if self._view.std() > PRINT_GREY:
            if max(self._likeness(view, turn) for turn in turns) > LIKE:
                return ''
            if not _even(self._view):  # else a finger or a shadow may have been on it
                return f'what is found does not look like the face did {FORGET}'
        level, before = float(np.median(view)), light * float(np.median(self._view))
        ratio = (level + DARK_GREY) / (before + DARK_GREY)
        if not 1.0 / BRIGHTER < ratio < BRIGHTER:
            return (f'what is found is of grey level {level:.0f}, the face was of {before:.0f} '
                    + FORGET)
        return '' if _even(view) \
            else f'what is found is not of one colour as the face was {FORGET}'

    def best_turn(self, image: np.ndarray, corners_px: np.ndarray,
                  turns: tuple[int, ...]) -> int:
        """
        Say by how many places corners (4, 2) must be rolled for the print to be upright.

        The first of the turns where no print is known again.
        """
        if self._view is None or self._view.std() <= PRINT_GREY:
            return turns[0]
        view = rectified_view(image, corners_px, GRID, INSET)
        best = max(turns, key=lambda turn: self._likeness(view, turn))
        return best if self._likeness(view, best) > LIKE else turns[0]

    def _likeness(self, view: np.ndarray, turn: int) -> float:
        """Correlate a view whose corners are rolled with the face."""
        assert self._view is not None
        view = np.rot90(view, turn)
        spread = float(view.std()) * float(self._view.std())
        if spread < 1e-6:
            return 0.0
        return float(np.mean((view - view.mean()) * (self._view - self._view.mean()))) / spread


def _even(view: np.ndarray) -> bool:
    """Tell whether a view shows one colour, but for a part of it."""
    level = float(np.median(view))
    return bool((np.abs(view - level) < max(EVEN_GREY, EVEN_SHARE * level)).mean() > EVEN)
