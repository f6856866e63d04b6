"""python -m pipeline scene=synthetic/wheel: one run, or with -m a sweep of runs. See conf/config.yaml."""

from pipeline.cli import main

if __name__ == "__main__":
    main()
