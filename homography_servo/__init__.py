"""Visual servoing along paths that are planned, checked and shown before anything moves."""

__version__ = '0.1.0'
