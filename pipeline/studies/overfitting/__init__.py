"""Overfitting: training against held-out views, effective view counts, lifetimes, error in moving and static pixels."""
