"""Fuzzing: invalid files for every reader and invalid arguments for `rasterize`, in search of a violated rule.

The rule for a reader: any bytes give a valid result, or a ValueError of one line that names the file, what was expected
and what was found; never another exception, a crash, a hang or a warning.

A target (target.py) is a valid example, a Hypothesis strategy of changes to it, and a check of the rule. To add one:
    1. write targets/<name>.py (of a scene: targets/data/) with example(), changes(), check() and TARGET;
       targets/data/frame_store.py is a short one; folders of other tools are made by layout_target.py;
    2. run `PYTHONPATH=tests:tests/helpers python -m fuzz <name> --seconds 600`;
    3. fix what it finds, and move the saved input to regressions/<name>/<what it is>/, which test_fuzz.py replays.

    target.py              Target, the rule, saved inputs           targets/        targets; data/, layouts/: of scenes
    edits/                 changes to bytes, text, JSON, arrays     regressions/    inputs that once violated the rule
    search.py              runs a target with Hypothesis            scene_checks.py, model_checks.py
    subprocess_search.py   the search in a process that may crash   failing_targets.py, for the tests of the search

`python -m fuzz` lists the targets (with PYTHONPATH=tests:tests/helpers; `make fuzz` runs all). Hypothesis is used
because changes to a valid example get past the first checks of a reader, and because it shrinks inputs and repeats a
seed. Coverage-guided fuzzers would not see the libraries that decode (Pillow, FFmpeg, safetensors, the kernel).
"""
