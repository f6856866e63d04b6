"""python -m pipeline scene=synthetic/wheel: one run, or with -m a sweep of runs. See conf/config.yaml."""

import os

# Before anything loads OpenMP: its threads would otherwise spin while they wait, which on a machine that is busy with
# other things makes two threads up to ten times slower than one.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

from pipeline.cli import main  # noqa: E402

if __name__ == "__main__":
    main()
