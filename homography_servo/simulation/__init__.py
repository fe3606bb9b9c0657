"""A rendered world: what the fixed camera would see of the box in the arm's hand."""
