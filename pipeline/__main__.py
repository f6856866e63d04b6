"""python -m pipeline scene=synthetic/wheel: one run, or with -m a sweep of runs. See conf/config.yaml."""

import os
import sys

# Before anything loads OpenMP: for how long a thread spins while it waits for work, a fraction of a millisecond. Not at
# all costs a twentieth of a training iteration in waking up; for long, as is the default, makes two threads up to ten
# times slower than one on a machine that is busy with other things.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")

if __name__ == "__main__":
    try:
        from pipeline.cli import main

        main()
    except KeyboardInterrupt:  # while modules are still being loaded
        print("error: interrupted; nothing of the run was saved yet; the same command starts it anew", file=sys.stderr)
        sys.exit(130)
