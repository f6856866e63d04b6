"""python -m pipeline scene=synthetic/wheel: one run, or with -m a sweep of runs. See conf/config.yaml."""

import os

# Before anything loads OpenMP: for how long a thread spins while it waits for work, a fraction of a millisecond. Not at
# all costs a twentieth of a training iteration in waking up; for long, as is the default, makes two threads up to ten
# times slower than one on a machine that is busy with other things.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")

from pipeline.cli import main  # noqa: E402

if __name__ == "__main__":
    main()
