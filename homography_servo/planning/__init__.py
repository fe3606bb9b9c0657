"""Whether a path can be driven, how to repair it, and how to drive it."""
