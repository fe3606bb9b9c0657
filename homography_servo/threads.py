"""Threads of the linear algebra libraries: matrices here are small, one is enough."""

import os


def keep_to_one_thread() -> None:
    """Tell the libraries, unless the environment does; call it before numpy is loaded."""
    for name in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'):
        os.environ.setdefault(name, '1')
