"""Trials, figures and measurements."""
