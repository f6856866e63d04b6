"""How far float32 carries: hard cases, each with a bound, for the kernel beside its float64 twin.

python -m pipeline.studies.kernel_stability      # the table; exit status 1 where a bound is broken
"""
