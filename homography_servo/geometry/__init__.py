"""Cameras, homographies, poses and paths; numpy and scipy only."""
