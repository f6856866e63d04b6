"""Staged experiments on 4D Gaussian Splatting: initialise, train, evaluate, report."""
