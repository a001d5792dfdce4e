"""invid: field identification of elastic robot drives, and what the simulation still gets wrong."""

import os

__version__ = "0.1.0"

# All linear algebra here is many small matrices. BLAS threads that wait for each other on them cost a
# factor of ten in time on a busy machine (measured: a diagnosis 65 s instead of 14 s of CPU), so they
# are off unless the environment asks for them. Takes effect where numpy is not imported yet.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
