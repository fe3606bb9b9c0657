"""Thin ROS adapters; the only folder, with launch, that imports ROS."""
