"""Staged experiments on 4D Gaussian Splatting: initialise, train, evaluate, report."""

import sys
from pathlib import Path

# Other packages and folders are called `datasets`, too: ours is beside this package, whatever comes first on the path.
_ROOT = str(Path(__file__).resolve().parents[1])
if sys.path[:1] != [_ROOT]:
    sys.path.insert(0, _ROOT)
_datasets = getattr(sys.modules.get("datasets"), "__file__", None)
if _datasets and Path(_datasets).resolve().parents[1] != Path(_ROOT):
    raise ImportError(f"datasets: expected {_ROOT}/datasets, found {_datasets} imported before; import pipeline first")
