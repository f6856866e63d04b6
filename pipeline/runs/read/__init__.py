"""Run folders read back: one row a run, under names that tell models and settings apart."""
