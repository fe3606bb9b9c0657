"""The B-spline snake that follows the face of the object through the images."""
