"""Follow the face from picture to picture, and doubt what does not fit."""

from __future__ import annotations

from homography_servo.result import Rejected
from homography_servo.result import required
from homography_servo.tracking.box import BoxSides
from homography_servo.tracking.detection.box_fit import held_by_box
from homography_servo.tracking.detection.box_views import box_points
from homography_servo.tracking.detection.outlook import smoothed
from homography_servo.tracking.doubts import contradicts
from homography_servo.tracking.doubts import FaceCheck
from homography_servo.tracking.doubts import surprise
from homography_servo.tracking.doubts import vagueness
from homography_servo.tracking.doubts import weak_support
from homography_servo.tracking.face_shape import FaceShape
from homography_servo.tracking.focus import first_focus
from homography_servo.tracking.focus import refocus
from homography_servo.tracking.level_memory import LevelMemory
from homography_servo.tracking.locate import Locator
from homography_servo.tracking.motion import both
from homography_servo.tracking.motion import Motion
from homography_servo.tracking.motion import shape_prior
from homography_servo.tracking.plane import Plane
from homography_servo.tracking.polygon_fit import Look
from homography_servo.tracking.polygon_fit import Prior
from homography_servo.tracking.polygon_fit import SnakeFit
from homography_servo.tracking.print_follower import PrintFollower
from homography_servo.tracking.quality import INLIER_WEIGHT
from homography_servo.tracking.quality import SEEN_SIDE
from homography_servo.tracking.scan import read_scan
from homography_servo.tracking.snake import fit_snake
from homography_servo.tracking.tracker_settings import POLARITIES
from homography_servo.tracking.tracker_settings import TrackerSettings
import numpy as np

WIDE = (Look(4.0, 12, 3, 3, 3, 2.0, 1.0, 2.0), Look(2.0, 8, 3, 3, 3, 2.0, 0.5, 1.0))
MEDIUM = WIDE[1:]
GIVEN_SHAPE_SIGMA_PX = 4.0  # of corners that a person, the arm or a rough look gives
FOCUS_HALF = 8  # pixels around the edges for a first look at the blur
SMALL_MISS = 1.0 / 3.0  # of what may be missed: so near its known shape it is still the face
SELDOM = 4  # one picture in so many bears what need not be done in each
REFOCUS_EVERY, REFOCUS_FIRST, KEY_EVERY = 3 * SELDOM, 10, 3 * SELDOM  # pictures
MOST_ROUNDS = 6  # of a first fit, until it is sure
STEADY_PX = 0.03  # a round that moves it by less is the last: the next hardly does
ROUND_PX = 8  # sides of a face that is followed are cut to a multiple of this
DONE_SIGMAS = 20.0  # a step leaves about 1/20 of itself: less than what noise moves


class Follower:
    """
    Everything that is remembered about a face that is being followed.

    Parameters
    ----------
    settings : TrackerSettings
        How to follow and trust.
    plane : Plane
        Straightens the lens.
    face_size_m : (float, float)
        Width and height of the face.
    box_height_m : float
        How far the box reaches behind the face.

    """

    def __init__(self, settings: TrackerSettings, plane: Plane,
                 face_size_m: tuple[float, float], box_height_m: float) -> None:
        self.settings, self._plane = settings, plane
        self.blur_px = settings.edge_blur_px
        self._box: BoxSides | None = None
        if box_height_m > 0.0 and plane.camera is not None:
            self._box = BoxSides(face_size_m, box_height_m, plane)
        self._points_m = box_points(face_size_m, box_height_m)
        self._locator, self._accepted = Locator(), 0
        self._unlearnt = 0  # pictures that have not told the levels of the box's sides
        self._face, self._shape = FaceCheck(face_size_m, plane), FaceShape(face_size_m, plane)
        self._print = PrintFollower(plane, self._face)
        self.forget()

    @property
    def following(self) -> bool:
        """Tell whether there is a face to follow."""
        return self._motion is not None

    @property
    def last_px(self) -> np.ndarray | None:
        """Give the last corners in the image."""
        if self._motion is None or self._motion.corners is None:
            return None
        return self._plane.to_image(self._motion.corners)

    def silhouette_px(self, corners: np.ndarray) -> np.ndarray:
        """Give the points (M, 2) in the image between which the object is."""
        return self._plane.to_image(corners if self._box is None
                                    else self._box.silhouette(corners))

    def forget(self) -> None:
        """Stop following; what the face looks like stays known."""
        self._motion: Motion | None = None
        self._vague: SnakeFit | None = None  # could be the face, but a corner is too uncertain
        self._memory: LevelMemory | None = None
        self._shape.forget()
        self._forget_pose()

    def _forget_pose(self) -> None:
        if self._box is not None:
            self._box.forget()

    def follow(self, image: np.ndarray, stamp_s: float,
               given_px: np.ndarray | None) -> SnakeFit | Rejected:
        """
        Find the face near where it must be by now.

        Parameters
        ----------
        image : (H, W) uint8 array
            The picture.
        stamp_s : float
            When it was taken.
        given_px : (4, 2) array or None
            Corners that somebody expects.

        Returns
        -------
        SnakeFit or Rejected

        """
        prior, self._vague = required(self._motion, 'face to follow').predict(stamp_s), None
        fit = self._by_print(image, prior.corners, prior) if self._print.needed \
            else self._fine(image, prior)
        if fit:
            return fit
        why = fit
        located = self._locate(image, prior.corners)
        given = None if given_px is None else self._plane.from_image(given_px)
        for corners in (located, given):
            if not fit and corners is not None and not self._print.needed:
                fit = self._beside(image, Prior(corners, prior.information))
        for corners in (prior.corners, located):
            if not fit and corners is not None:
                fit = self._by_print(image, corners, prior)
        told = None if fit else self._told_by_box(image, prior.corners)
        if told is not None:
            fit = self._fine(image, both(prior, told))
        if not fit or (self._vague is not None and contradicts(fit, self._vague)):
            return why
        self._vague = None
        return fit

    def _beside(self, image: np.ndarray, expected: Prior) -> SnakeFit | Rejected:
        """Look where the whole face may have gone; it may look no other there than expected."""
        fit = self._near(image, expected, MEDIUM)
        if isinstance(fit, Rejected):
            return fit
        doubt = surprise(fit, expected, self.settings, True)
        return Rejected(doubt) if doubt else fit

    def stay(self, stamp_s: float) -> bool:
        """Keep to the face where the last picture was only too vague; tell whether it was."""
        if self._vague is None:
            return False
        self._moved(self._vague, stamp_s)
        return True

    def _moved(self, fit: SnakeFit, stamp_s: float) -> None:
        """Learn where the face is, and of corners that no edge shows how well that is known."""
        covariance = fit.covariance if fit.judged.clear else fit.told_by_pictures
        required(self._motion, 'face to follow').measured(fit.corners, covariance, stamp_s)

    def capture(self, image: np.ndarray, prior: Prior, told: bool = False) -> SnakeFit | Rejected:
        """
        Find the face around corners that are known to some pixels only.

        Parameters
        ----------
        image : (H, W) uint8 array
            The picture.
        prior : Prior
            Where the corners are thought to be.
        told : bool
            Whether a person says so: then a face with print may have weak edges.

        Returns
        -------
        SnakeFit or Rejected

        """
        self._forget_pose()
        fit = self._fine(image, prior) or self._near(image, prior, WIDE)
        if not fit:
            corners = self._locate(image, prior.corners)
            if corners is not None:
                fit = self._near(image, Prior(corners, prior.information), MEDIUM)
        if not fit and told:
            return self._print.begin(image, prior, self.blur_px, self.settings)
        if isinstance(fit, Rejected) or self._accepted:
            return fit
        return self.settle(image, fit)

    def _by_print(self, image: np.ndarray, corners: np.ndarray,
                  expected: Prior) -> SnakeFit | Rejected:
        return self._print.fit(image, corners, expected, self.blur_px, self.settings,
                               self.following)

    def settle(self, image: np.ndarray, fit: SnakeFit) -> SnakeFit | Rejected:
        """Learn blur and the levels of the box's sides from a first fit, and fit again."""
        self._forget_pose()
        settled = self._settled(image, fit)
        if settled:
            return settled
        told = self._told_by_box(image, fit.corners)
        return settled if told is None else self._settled(image, fit, told) or settled

    def _settled(self, image: np.ndarray, first: SnakeFit,
                 box: Prior | None = None) -> SnakeFit | Rejected:
        """Settle with what the edges of the box tell, if they are asked."""
        def near(corners: np.ndarray) -> Prior:
            shape = shape_prior(corners, GIVEN_SHAPE_SIGMA_PX)
            return shape if box is None else both(shape, box)

        scan, fit = read_scan(image, first.corners, self._plane, FOCUS_HALF), first
        if scan is not None:
            self.blur_px = first_focus(scan, fit.corners)
        for _ in range(MOST_ROUNDS):
            self._learn_sides(fit)
            again = self._sharp(image, near(fit.corners))
            if isinstance(again, Rejected):
                return again
            begun = (again.strips is None) != (fit.strips is None)  # to look at the sides
            steady = float(np.abs(again.corners - fit.corners).max()) < STEADY_PX
            before, fit = fit, again
            if not begun and not (weak_support(fit, self.settings)
                                  or vagueness(fit, self.settings)):
                break
        far_px = float(np.abs(fit.corners - first.corners).max())
        if far_px > self.settings.edge_half_px:  # edges that the first fit has not seen
            return Rejected(f'the fit runs away, by {far_px:.1f} px')
        if steady:
            done = self._trusted(image, fit, near(before.corners))
            if done:
                return done
        self._learn_sides(fit)
        return self._fine(image, near(fit.corners))

    def _learn_sides(self, fit: SnakeFit, pictures: int = 1) -> None:
        if self._box is not None:
            self._box.learn(fit.edges, fit.weight, fit.strips, self.settings.edge_half_px,
                            pictures)

    def accept(self, image: np.ndarray, fit: SnakeFit, stamp_s: float) -> None:
        """Learn from a fit that is trusted."""
        if self._motion is None:
            self._motion = Motion()
        self._moved(fit, stamp_s)
        self._accepted += 1
        self._unlearnt += 1
        posed = fit.judged.least_side_share > SEEN_SIDE  # else strips are not known to be so wide
        if posed and (fit.edges.second is not None or self._accepted % SELDOM == 1):
            self._learn_sides(fit, self._unlearnt)
            self._unlearnt = 0
        if self._accepted % SELDOM == 1:
            self._locator.remember(image, self._plane.to_image(fit.corners))
        if not self._print.known and self._accepted % KEY_EVERY == 1:
            self._print.remember(image, fit.corners)
        known, memory = fit.edges.known, self._memory
        self._memory = LevelMemory.first(known) if memory is None else memory.updated(known)
        if fit.by_print:
            return  # its edges are too weak to learn from
        self._shape.learn(fit)
        if self._accepted <= REFOCUS_FIRST or self._accepted % REFOCUS_EVERY == SELDOM + 1:
            clean = (fit.weight > INLIER_WEIGHT) & fit.edges.single
            self.blur_px = refocus(required(fit.scan, 'scan'), fit.corners, clean, self.blur_px)

    def _locate(self, image: np.ndarray, corners: np.ndarray) -> np.ndarray | None:
        shown = self._locator.locate(image, self._plane.to_image(corners),
                                     self.settings.search_px)
        return None if shown is None else self._plane.from_image(shown)

    def _near(self, image: np.ndarray, prior: Prior,
              looks: tuple[Look, ...]) -> SnakeFit | Rejected:
        """Go from soft and wide to sharp and narrow."""
        start = prior
        for look in looks:
            wide = fit_snake(image, start.corners, look, self._plane, start,
                             POLARITIES[self.settings.polarity])
            if isinstance(wide, Rejected):
                return wide
            start = shape_prior(wide.corners, GIVEN_SHAPE_SIGMA_PX)
        return self._fine(image, start)

    def _fine(self, image: np.ndarray, prior: Prior) -> SnakeFit | Rejected:
        """Fit to all pixels of the edges, and doubt what comes out."""
        fit = self._sharp(image, prior)
        return fit if isinstance(fit, Rejected) else self._trusted(image, fit, prior)

    def _told_by_box(self, image: np.ndarray, corners: np.ndarray) -> Prior | None:
        """Let the edges of the box tell where corners are that have no edges of their own."""
        return None if self._box is None \
            else held_by_box(smoothed(image), corners, self._points_m, self._plane)

    def _trusted(self, image: np.ndarray, fit: SnakeFit, prior: Prior) -> SnakeFit | Rejected:
        """Doubt a fit that was found with a prior."""
        settings, following = self.settings, self.following
        doubt = weak_support(fit, settings) or surprise(fit, prior, settings, following)
        seldom = self._accepted % SELDOM == 0
        if not doubt and (seldom or not fit.judged.clear):
            small_px = SMALL_MISS * settings.max_shape_miss_px
            if seldom or self._shape.miss_px(fit.corners) > small_px:
                doubt = self._face.doubt(fit.corners, settings)
            doubt = doubt or self._elsewhere(image, fit)
        if doubt:
            return Rejected(doubt)
        vague = vagueness(fit, settings)
        if not vague:
            return fit
        if following and self._vague is None:  # the first is held by what is known best
            self._vague = fit
        return Rejected(vague)

    def _elsewhere(self, image: np.ndarray, fit: SnakeFit) -> str:
        """Compare with how the face looked where a side shows no edge; it may be hidden."""
        if not self.following or fit.judged.least_side_share > SEEN_SIDE \
                or not self._locator.beside(image, self._plane.to_image(fit.corners)):
            return ''
        return 'the face looks to be beside the edges that were found'

    def _sharp(self, image: np.ndarray, prior: Prior) -> SnakeFit | Rejected:
        blur_px = round(50.0 * self.blur_px) / 50.0
        half = self.settings.edge_half_px + max(0, round(2.0 * (blur_px - 0.8)))
        strips, outline = (None, None) if self._box is None else self._box.predict(prior.corners)
        if self.following:
            rigid = self._shape.prior(prior.corners)
        else:
            rigid = None if outline is None else outline.rigid
        held = prior if rigid is None else both(prior, rigid)
        look = Look(blur_px, half, done_sigmas=DONE_SIGMAS,
                    round_px=ROUND_PX if self.following else 1)
        fit = fit_snake(image, prior.corners, look, self._plane, held,
                        POLARITIES[self.settings.polarity], strips, self._memory)
        return fit if isinstance(fit, Rejected) else fit._replace(shape=rigid)
