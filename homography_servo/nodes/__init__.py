"""Thin ROS adapters; the only folder, with launch, that imports ROS."""

from homography_servo.threads import keep_to_one_thread

keep_to_one_thread()  # more would only take processor time from the other nodes
