"""Thin ROS adapters; the only folder, with launch, that imports ROS."""

import os

# Matrices here are small: threads of the linear algebra libraries would only take
# processor time from the other nodes. They must be told before numpy is loaded.
for _name in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')
