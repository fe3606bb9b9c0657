"""
A closed quadratic B-spline with corners, as the paper's snake.

A knot of multiplicity two makes the curve pass through its control point with a
corner; the control points between two corners bend the side. A polygon of n corners
with s spans per side has n (s + 1) control points; the paper's box is n = 4, s = 2.
"""

from __future__ import annotations

import numpy as np


class ClosedSpline:
    """
    Closed quadratic B-spline whose basis is sampled once.

    Parameters
    ----------
    corner_count : int
        Corners of the polygon, at least 3.
    spans_per_side : int
        Quadratic pieces between two corners, at least 1.
    samples_per_span : int
        Points of the curve per piece, at least 1.

    """

    def __init__(self, corner_count: int = 4, spans_per_side: int = 2,
                 samples_per_span: int = 8) -> None:
        if corner_count < 3 or spans_per_side < 1 or samples_per_span < 1:
            raise ValueError('expected at least 3 corners, 1 span per side and 1 sample per span, '
                             f'got {corner_count}, {spans_per_side}, {samples_per_span}')
        self.corner_count = corner_count
        self.spans_per_side = spans_per_side
        self.control_count = corner_count * (spans_per_side + 1)
        self.corner_index = np.arange(corner_count) * (spans_per_side + 1)
        self.parameters = np.arange(corner_count * spans_per_side * samples_per_span) \
            / samples_per_span
        self.basis, self.slope_basis = self.basis_at(self.parameters)
        self.control_from_corners = self._straight_sides()
        self._outline_basis = self.basis @ self.control_from_corners

    def basis_at(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Evaluate all basis functions and their derivatives.

        Parameters
        ----------
        parameters : (M,) array
            Curve parameter in spans, from 0 at the first corner, periodic.

        Returns
        -------
        (M, control_count) array, (M, control_count) array
            Values and derivatives; curve = values @ control.

        """
        spans = self.corner_count * self.spans_per_side
        wrapped = np.mod(np.asarray(parameters, dtype=float), spans)
        span = np.minimum(wrapped.astype(int), spans - 1)
        side, piece = np.divmod(span, self.spans_per_side)
        values, slopes = _quadratic(wrapped - span, *self._knots_around(piece))
        first = side * (self.spans_per_side + 1) + piece
        columns = (first[:, None] + np.arange(3)) % self.control_count
        basis = np.zeros((2, len(wrapped), self.control_count))
        rows = np.arange(len(wrapped))[:, None]
        basis[0][rows, columns] = values
        basis[1][rows, columns] = slopes
        return basis[0], basis[1]

    def corners(self, control: np.ndarray) -> np.ndarray:
        """Pick the (corner_count, 2) control points that the curve passes through."""
        return control[self.corner_index]

    def control(self, corners: np.ndarray) -> np.ndarray:
        """Place the (control_count, 2) control points for straight sides between corners."""
        return self.control_from_corners @ corners

    def curve(self, control: np.ndarray) -> np.ndarray:
        """Sample the (M, 2) points of the curve."""
        return self.basis @ control

    def outline(self, corners: np.ndarray) -> np.ndarray:
        """Sample the (M, 2) points of the curve with straight sides between corners."""
        return self._outline_basis @ corners

    def normals(self, control: np.ndarray) -> np.ndarray:
        """
        Give the (M, 2) unit normals at the samples.

        They point inwards where the corners run clockwise on the screen (v down).
        """
        tangent = self.slope_basis @ control
        length = np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        return np.column_stack([-tangent[:, 1], tangent[:, 0]]) / length

    def _knots_around(self, piece: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Measure the knot intervals before and after a piece: 0 beside a corner, else 1."""
        return (piece > 0).astype(float), (piece < self.spans_per_side - 1).astype(float)

    def _straight_sides(self) -> np.ndarray:
        """Map corners to control points at the Greville abscissae of each side."""
        spans = self.spans_per_side
        knots = np.concatenate([[0.0, 0.0], np.arange(spans + 1), [spans, spans]])
        share = (knots[1:spans + 2] + knots[2:spans + 3])[:spans + 1] / (2.0 * spans)
        matrix = np.zeros((self.control_count, self.corner_count))
        for corner in range(self.corner_count):
            rows = corner * (spans + 1) + np.arange(spans + 1)
            matrix[rows, corner] = 1.0 - share
            matrix[rows, (corner + 1) % self.corner_count] = share
        return matrix


def _quadratic(u: np.ndarray, before: np.ndarray, after: np.ndarray) \
        -> tuple[np.ndarray, np.ndarray]:
    """Evaluate the three basis functions on a unit span by de Boor's recursion."""
    left = (1.0 - u) / (1.0 + before)
    right = u / (1.0 + after)
    values = np.stack([left * (1.0 - u), left * (before + u) + right * (1.0 - u + after),
                       right * u], axis=1)
    slopes = np.stack([-2.0 * left, 2.0 * (left - right), 2.0 * right], axis=1)
    return values, slopes
