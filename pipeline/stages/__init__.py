"""A run: prepare → settle → init → train → evaluate → page.

A stage that was finished with the same configuration, data and code is skipped.

run.py      the stages of a run, in order          settle.py   the configuration, with nothing left to decide
stages.py   what each stage does                   decide.py   the short trainings that settle may need
inputs.py   what each stage's result depends on    estimate.py time, memory and disk, before it starts
"""
